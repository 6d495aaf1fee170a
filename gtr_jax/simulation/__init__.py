"""One equilibrium, a load history, what load cells show of it, and its phases."""
