"""What a sampled signal shows by itself: its noise, where it turns, where it stands still."""
