"""The routing that reaches a pose, and what the tip does when the design changes."""

from gtr_jax.notebook import cards_come_with

from .optimise import optimise
from .result import Design
from .sensitivity import Sensitivities, pose_sensitivity
from .target import TargetConfig, load_target, parse_target

__all__ = [
    "Design",
    "Sensitivities",
    "TargetConfig",
    "load_target",
    "optimise",
    "parse_target",
    "pose_sensitivity",
]


def _import_cards() -> None:
    from .report import design  # noqa: F401


cards_come_with(_import_cards)
