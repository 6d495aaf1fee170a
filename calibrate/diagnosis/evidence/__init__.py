"""How probable each model is, and the numbers that hold over all of them."""
