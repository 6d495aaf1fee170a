"""The live page: a robot with a slider for every number, simulated again as they move."""
