"""What so far is computed in the plane only refuses robots that leave it."""

from __future__ import annotations

from gtr_jax.errors import InputError

from .parts import Parts


def refuse_space(robot: Parts, what: str, *, source: str = "") -> None:
    """InputError if a robot is computed in space.

    Args:
        robot: in question.
        what: does not take it, for the message: "a fit".
        source: its file, or its name unless given.
    """
    if robot.space:
        raise InputError(
            f"{source or robot.name}: the robot leaves its plane, or has what only robots in space have; "
            f"{what} takes robots in one plane so far; gtr simulate and gtr fit take this one"
        )
