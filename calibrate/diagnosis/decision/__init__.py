"""The verdict, from stated quantities."""
