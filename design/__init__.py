"""What the tip does when the design changes; the choice of the routing itself comes later."""

from .sensitivity import Sensitivities, pose_sensitivity

__all__ = ["Sensitivities", "pose_sensitivity"]
