"""Benchmarks: speed against the project's targets, and the study that chose the solver and the mesh."""
