"""What is left out of a recording before it is compared: glitches, dropouts, stretches a user drops."""
