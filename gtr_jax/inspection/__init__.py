"""What a recording says before any model of the robot: sampling, cells, delay, cycles, phases, and what is missing."""
