"""Refits: one effect, several, and what cannot be told apart."""
