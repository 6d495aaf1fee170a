"""Which program solves a robot: the equations that it needs, known before tracing."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection

import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from .. import mechanics
from ..mechanics import ProgramSpec, every, in_order
from ..mechanics.program_spec import carried
from ..mechanics.sections import Sections
from ..robot.robot import Robot, tip_moment_of
from ..terms import known_acting, known_on
from ..terms.term import ONE_HELD
from ..terms.unmoved import unmoved


def structure_of(robot: Robot, with_terms: bool | Collection[str] | None) -> ProgramSpec:
    """The equations that a robot needs.

    Args:
        robot: the robot.
        with_terms: as for `simulate`.
    """
    if isinstance(with_terms, bool):
        return structure_with(robot, every_for(robot) if with_terms else ())
    if with_terms is not None:
        return structure_with(robot, with_terms)
    acting = _acting(robot)
    return dataclasses.replace(structure_with(robot, tuple(acting)), acting=all(acting.values()))


def _acting(robot: Robot) -> dict[str, bool | None]:
    """The terms that act or may act, and whether that is known."""
    known = {kind: known_on(robot.catalogue[kind], robot.terms[kind]) for kind in every(robot.laws)}
    return {kind: on for kind, on in known.items() if (kind in robot.acting if on is None else on)}


def every_for(robot: Robot) -> tuple[str, ...]:
    """The terms that a robot may have."""
    return tuple(kind for kind in every(robot.laws) if kind not in _of_one_tendon(robot))


def _of_one_tendon(robot: Robot) -> list[str]:
    """The terms that a robot in space may have with one tendon only."""
    return carried(every(robot.laws), robot.catalogue) if robot.space and robot.tendon_names else []


def structure_with(robot: Robot, terms: Collection[str]) -> ProgramSpec:
    """The structure that has the equations of some terms, whether they act or not.

    Args:
        robot: the robot.
        terms: their names; those of the load cells have no equations.
    """
    loads = any(robot.catalogue[kind].loads for kind in terms)
    refuse_in_space(robot, terms)
    return ProgramSpec(
        in_order(terms, robot.laws),
        len(robot.tendon_names),
        robot.loaded or loads or _tip_moment_acts(robot),
        space=robot.space,
        laws=robot.laws,
    )


def _known(value: Array) -> np.ndarray | None:
    """A number of the robot; None while it is traced."""
    return None if isinstance(value, Tracer) else np.asarray(value)


def _tip_moment_acts(robot: Robot) -> bool:
    """Whether a moment at the tip of a robot in space is known to act. It turns against the sections, so that
    the body bends along a curve of its own, like under a force.
    """
    moment = _known(robot.loads.tip_moment) if robot.space and not robot.backbone.rigid else None
    return moment is not None and bool(np.any(moment != 0))


def refuse_in_space(robot: Robot, terms: Collection[str]) -> None:
    """ValueError if a robot of several tendons in space has a term that bends what friction holds."""
    for kind in _of_one_tendon(robot):
        if kind in terms:
            raise ValueError(f"{kind}: {ONE_HELD}")


def at_nodes(robot: Robot, s: Sections) -> mechanics.NodalRobot:
    """The robot as the mechanics takes it."""
    return mechanics.NodalRobot(
        sections=s,
        mu=robot.per_tendon(lambda tendon: tendon.friction_coefficient),
        preload=robot.per_tendon(lambda tendon: tendon.preload),
        tip_moment=tip_moment_of(robot),
        terms=robot.terms,
    )


def unmoved_in(robot: Robot) -> list[str]:
    """Terms that are known to act on a rigid sheath and cannot, because its tendon does not slip; none where
    the numbers of one that stretches the tendon are traced.
    """
    if not robot.backbone.rigid or isinstance(robot.backbone.length, Tracer):
        return []
    known = {term.id: known_on(term, robot.terms[term.id]) for term in robot.catalogue.values()}
    if any(on is None and robot.catalogue[kind].strain for kind, on in known.items()):
        return []
    acting = [kind for kind, on in known.items() if on]
    return unmoved(robot.catalogue, robot.terms, acting, float(robot.backbone.length))


def known_to_act(robot: Robot) -> bool:
    """Whether any physics term that is not of the load cells is known to act; none is while it is traced."""
    return bool(in_order(known_acting(robot.terms, robot.laws), robot.laws))


def terms_act(robot: Robot) -> bool:
    """Whether any physics term acts that is not of the load cells; where their numbers are traced, whether
    any may.
    """
    return bool(_acting(robot))
