"""A robot for other programs: drawings and curves for CAD (DXF, STEP), a model for MuJoCo."""
