"""Hypotheses tried at finite sizes before any is refitted."""
