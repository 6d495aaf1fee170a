"""What may be missing: each effect as a hypothesis, and sets of them as models."""
