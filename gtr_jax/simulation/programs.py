"""Which program solves a robot: the equations that it asks for, known before anything is traced."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection

import equinox as eqx
import jax
import jax.tree_util as jtu
from jaxtyping import Array, Bool

from .. import mechanics
from ..mechanics import EVERY, Structure, in_order
from ..mechanics.sections import Sections
from ..mechanics.tangents import split_tangents
from ..robot.robot import Robot
from ..terms import REGISTRY, any_on, known_on


def structure_of(robot: Robot, with_terms: bool | Collection[str] | None) -> Structure | None:
    """The equations that a robot asks for; None if numbers are being traced that decide it.

    Args:
        robot: the robot.
        with_terms: as for `simulate`.
    """
    known = with_terms is None
    if with_terms is None:
        acting = {kind: known_on(REGISTRY[kind], robot.terms[kind]) for kind in EVERY}
        if None in acting.values():
            return None
        with_terms = [kind for kind, on in acting.items() if on]
    elif isinstance(with_terms, bool):
        with_terms = EVERY if with_terms else ()
    return dataclasses.replace(structure_with(robot, with_terms), acting=known)


def structure_with(robot: Robot, terms: Collection[str]) -> Structure:
    """The equations of some terms, acting or not.

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


def by_structure(solved, pair, structure: Structure | None, robot: Robot, *rest):
    """What a program of some structure gives; where that is not known while tracing, one program has the base
    model and all physics terms and decides when it runs.

    Its derivatives by numbers of the terms are those with all terms, which at the null values is the same
    function.

    Args:
        solved: from a structure, the robot and the rest.
        pair: the base model of several tendons, from the robot and the rest.
        structure: which equations act, or None.
        robot, rest: the arguments.
    """

    def of(structure: Structure):
        if structure.tendons and not structure.terms:
            return pair
        return functools.partial(solved, structure)

    if structure is not None:
        return of(structure)(robot, *rest)
    both = tuple(
        of(Structure(terms, len(robot.tendon_names), robot.loaded or bool(terms))) for terms in ((), EVERY)
    )
    return _either(both, (robot, *rest))


def _terms_act(robot: Robot) -> Bool[Array, ""]:
    """Whether any physics term is on that is not of the load cells."""
    return any_on(robot.terms, lambda term: not term.of_cells)


@eqx.filter_custom_jvp
def _either(choices, inputs):
    plain, with_terms = choices
    return jax.lax.cond(_terms_act(inputs[0]), with_terms, plain, *inputs)


@_either.def_jvp
def _either_jvp(primals, tangents):
    (plain, with_terms), inputs = primals
    inputs_dot = tangents[1]
    moving, fixed = split_tangents(inputs, inputs_dot)
    by_terms = jtu.tree_leaves(inputs_dot[0].terms)

    def chosen(moving):
        robot, *rest = eqx.combine(moving, fixed)
        if by_terms:
            return with_terms(robot, *rest)
        return jax.lax.cond(_terms_act(robot), with_terms, plain, robot, *rest)

    return eqx.filter_jvp(chosen, (moving,), (inputs_dot,))


def known_to_act(robot: Robot) -> bool | None:
    """Whether any physics term acts that is not of the load cells; None if that is being traced."""
    structure = structure_of(robot, None)
    return None if structure is None else bool(structure.terms)
