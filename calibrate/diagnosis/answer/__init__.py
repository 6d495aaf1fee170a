"""A diagnosis as it is stored and told."""
