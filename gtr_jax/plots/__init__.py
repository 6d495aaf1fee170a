"""Figures of simulations and sweeps, as matplotlib figures; nothing is shown or written here."""
