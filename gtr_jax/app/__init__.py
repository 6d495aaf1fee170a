"""What people start: the command `gtr`, its demo and the live page. Nothing imports it."""
