"""What a recording says before any model of the robot: of its clock, its cells, its load, what is missing."""
