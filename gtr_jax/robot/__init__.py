"""The robot as numbers: body, channels, tendons, loads, named parameters; built from the robot file."""
