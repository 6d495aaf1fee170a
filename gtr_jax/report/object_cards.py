"""What a notebook shows of a robot and of a simulation."""

from __future__ import annotations

import jax
import numpy as np
from jax.core import Tracer

from gtr_jax.config.config import RobotConfig
from gtr_jax.notebook import draws
from gtr_jax.numbers import number, quantity

from ..plots.loop import plot_loop
from ..plots.straight import plot_straight
from ..plots.tendons import plot_tendons
from ..robot.build import build_robot
from ..robot.parameters import Parameter, parameters_of
from ..robot.robot import Robot
from ..simulation.history import Simulation
from ..simulation.phases import label_phases
from .card import card
from .page import Figure, Report, Table
from .spatial import tip_angle

DOTS = 110  # per inch: enough for a notebook, and half as large as in a report


def is_known(tree: object) -> bool:
    """Whether all its numbers are known: none is when JAX traces it, or has only its shapes."""
    leaves = jax.tree_util.tree_leaves(tree)
    return not any(isinstance(leaf, Tracer | jax.ShapeDtypeStruct) for leaf in leaves)


@draws(RobotConfig)
def config_card(config: RobotConfig) -> str | None:
    """Of a robot file: the robot that it makes."""
    return robot_card(build_robot(config))


@draws(Robot)
def robot_card(robot: Robot) -> str | None:
    """The straight body with its channels, and the numbers that say something; None where they are unknown,
    as while it is traced, or it is a batch of robots or a part of one.
    """
    if not is_known(robot) or not _is_one(robot):
        return None
    every = parameters_of(robot)
    shown = [(p, float(robot.value(name))) for name, p in every.items()]
    rows = [(p.name, quantity(value, p.unit), p.key) for p, value in shown if _says(robot, p, value)]
    what = "in space" if robot.space else "in the plane"
    many = len(robot.tendons)
    tendons = "one tendon" if many == 1 else f"{many} tendons"
    rigid = ", a sheath of fixed shape" if robot.backbone.rigid else ""
    picture = Figure("channels", plot_straight(robot), "The straight body with its channels.", DOTS)
    return card(
        Report(
            title=robot.name,
            verdict=f"A robot {what} with {tendons}{rigid}.",
            figures=[picture],
            tables=[Table("Numbers", ("", "value", "key in the robot file"), rows)],
        )
    )


def _is_one(robot: Robot) -> bool:
    """Whether it is one robot: neither many side by side, as `vmap` makes them, nor a part of one."""
    body = robot.backbone
    needed = [body.length, *(tendon.friction_coefficient for tendon in robot.tendons)]
    if any(value is None for value in needed) or any(map(np.ndim, [*needed, body.youngs_modulus])):
        return False
    # Numbers of a term may be one for each of several tendons.
    shapes = {np.shape(value) for value in jax.tree_util.tree_leaves(robot.terms)}
    return shapes <= {(), *([(len(robot.tendons),)] if robot.tendon_names else [])}


def _says(robot: Robot, p: Parameter, value: float) -> bool:
    """Whether a number is worth a row: that of a term only if the term acts, others unless they are zero."""
    if p.term is not None:
        values, (_, _, *tendon) = robot.terms[p.term.id], p.name.split(".")
        own = robot.tendon_names.index(tendon[0]) if tendon else ...
        return any(float(np.asarray(values[q.name])[own]) != q.null for q in p.term.sizes if q.name in values)
    return (value != 0 and np.isfinite(value)) or p.name.partition(".")[0] == "mu"


@draws(Simulation)
def simulation_card(run: Simulation) -> str | None:
    """The loop, or the tensions of several tendons, and where the tip ends; None where its numbers are
    unknown, as while it is traced, or it is a batch of simulations.
    """
    if not is_known(run) or np.ndim(run.residual_norm) != 1:
        return None
    T_base, T_tip = np.asarray(run.T_base), np.asarray(run.T_tip)
    failed, steps = int(np.sum(~np.asarray(run.converged))), len(T_base)
    says = f"{steps} load steps" + (
        ", all converged." if not failed else f", of which {failed} did not converge: do not use these."
    )
    if T_base.ndim == 2:
        names = [str(k + 1) for k in range(T_base.shape[1])]
        picture = plot_tendons(T_base, T_tip, tip_angle(run), names)
        caption = "Tensions and the angle of the tip."
    else:
        picture = plot_loop(T_base, T_tip, phases=label_phases(run))
        caption = "Tension at the tip against tension at the base, by phase."
    top = int(np.argmax(T_base.reshape(steps, -1).sum(axis=1)))
    rows = [
        (name, *(_tensions(T[k]) for T in (T_base, T_tip)), _place(np.asarray(run.tip_position)[k]))
        for name, k in (("at the largest base tension", top), ("at the end", steps - 1))
    ]
    return card(
        Report(
            title="Simulation",
            verdict=says,
            figures=[Figure("loop", picture, caption, DOTS)],
            tables=[Table("", ("", "T_base", "T_tip", "place of the tip"), rows)],
        )
    )


def _tensions(values: np.ndarray) -> str:
    return ", ".join(number(float(v), digits=4) for v in np.atleast_1d(values)) + " N"


def _place(place: np.ndarray) -> str:
    return ", ".join(number(1e3 * float(v), digits=4) for v in place) + " mm"
