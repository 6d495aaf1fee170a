"""How well a model explains the recordings, and where it does not."""
