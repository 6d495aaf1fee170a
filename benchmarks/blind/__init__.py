"""Recordings of an independent machine, and what the diagnosis says of them."""
