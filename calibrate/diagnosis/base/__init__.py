"""The base model fitted to the recordings: load, fit, split what differs, mask what no model can know."""
