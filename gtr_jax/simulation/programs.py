"""Which program solves a robot: the equations that it needs, known before tracing."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection

from .. import mechanics
from ..mechanics import EVERY, Structure, in_order
from ..mechanics.sections import Sections
from ..robot.robot import Robot
from ..terms import REGISTRY, known_acting, known_on


def structure_of(robot: Robot, with_terms: bool | Collection[str] | None) -> Structure:
    """The equations that a robot needs.

    Args:
        robot: the robot.
        with_terms: as for `simulate`.
    """
    if isinstance(with_terms, bool):
        return structure_with(robot, EVERY if with_terms else ())
    if with_terms is not None:
        return structure_with(robot, with_terms)
    known = {kind: known_on(REGISTRY[kind], robot.terms[kind]) for kind in EVERY}
    acting = [kind for kind, on in known.items() if (kind in robot.acting if on is None else on)]
    return dataclasses.replace(structure_with(robot, acting), acting=all(known[kind] for kind in acting))


def structure_with(robot: Robot, terms: Collection[str]) -> Structure:
    """The structure that has the equations of some terms, whether they act or not.

    Args:
        robot: the robot.
        terms: their names; those of the load cells have no equations.
    """
    loads = any(REGISTRY[kind].loads for kind in terms)
    return Structure(in_order(terms), len(robot.tendon_names), robot.loaded or loads)


def at_nodes(robot: Robot, s: Sections) -> mechanics.Robot:
    """The robot as the mechanics takes it."""
    return mechanics.Robot(
        sections=s,
        mu=robot.per_tendon(lambda tendon: tendon.friction_coefficient),
        preload=robot.per_tendon(lambda tendon: tendon.preload),
        tip_moment=robot.loads.tip_moment,
        terms=robot.terms,
    )


def known_to_act(robot: Robot) -> bool:
    """Whether any physics term that is not of the load cells is known to act; none is while it is traced."""
    return bool(in_order(known_acting(robot.terms)))


def terms_act(robot: Robot) -> bool:
    """Whether any physics term acts that is not of the load cells; where their numbers are traced, whether
    any may.
    """
    return bool(structure_of(robot, None).terms)
