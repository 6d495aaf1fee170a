"""The units of lengths that files for CAD may have."""

METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
