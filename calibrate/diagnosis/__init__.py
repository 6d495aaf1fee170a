"""Which physics a model leaves out: `diagnose.py` goes through these folders."""
