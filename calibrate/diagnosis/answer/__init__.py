"""A diagnosis as it is stored and put into words."""
