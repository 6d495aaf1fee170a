"""Recordings: read from tables or files, cleaned, and what signals show by themselves."""
