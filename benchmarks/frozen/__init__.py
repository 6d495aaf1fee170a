"""Freeze the answers of the whole program, and say what a change of its source did to them."""
