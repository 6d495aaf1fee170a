"""A design in words, tables and pictures."""
