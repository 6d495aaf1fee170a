"""Fits and diagnoses in words, tables and pictures."""
