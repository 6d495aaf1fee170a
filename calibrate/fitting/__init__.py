"""What `gtr fit` adds to inference: starts, profiles, what a recording leaves open, the answer in words."""
