"""Real robots: what a plain model misses of their recordings, what was found, and what it predicts."""
