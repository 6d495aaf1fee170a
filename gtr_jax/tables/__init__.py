"""Simulations as labelled datasets and tables, with units."""
