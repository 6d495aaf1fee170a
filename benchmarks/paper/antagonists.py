"""Two tendons that bend one body either way: what the antagonist's tension does to friction (reference [18]).

One tendon is pulled and released while the other's base is held at a constant tension. The held tendon slides
all the same: the bending body drags its channel along, so friction raises its tension towards the tip while
the pulled one's falls. For mirrored parallel channels, one friction coefficient and no external load both are
known in closed form during the pull, with c = integral of ds/(EI) and base tensions A > B:

    dphi/dc = R (A e^(-mu phi) - B e^(mu phi)),
    e^(mu phi) = sqrt(A/B) tanh(mu R sqrt(AB) c + artanh sqrt(B/A)).
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from gtr_jax.config.config import RobotConfig, load_config
from gtr_jax.mechanics.mesh import increments
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.robot import Robot, sections
from gtr_jax.simulation.history import Simulation, equilibrium_at, simulate
from gtr_jax.simulation.solution import Equilibrium

from .study import ROBOTS

FILE = ROBOTS / "antagonists.toml"
HELD = (0.5, 2.0, 5.0, 8.0)  # N
PULL = 15.0  # N
STEPS = 60


class Held(NamedTuple):
    """One tendon pulled to PULL and released to what the other is held at.

    held: that tension [N]. run: the history. top: step of the largest tension. pulled: the equilibrium there.
    exact: tip angle [rad] and tip tensions [N] there in closed form, (3,).
    """

    held: float
    run: Simulation
    top: int
    pulled: Equilibrium
    exact: np.ndarray


@functools.cache
def config() -> RobotConfig:
    """The robot file."""
    return load_config(FILE)


def strung(held: float) -> Robot:
    """The robot with both tendons at a preload [N]."""
    return build_robot(config()).with_values(**{"preload.left": held, "preload.right": held})


def closed_form(robot: Robot, A: float, B: float) -> np.ndarray:
    """Tip angle [rad], tip tension of the pulled and of the held tendon [N], (3,), while A rises over B.

    Args:
        robot: two parallel tendons at +-R with one friction coefficient, no load.
        A, B: base tensions [N], A > B > 0.
    """
    s = sections(robot)
    c = float(jnp.sum(increments(s.mesh.weights, s.compliance)))
    mu, R = float(robot.value("mu.left")), float(robot.value("offset.left"))
    ratio = np.sqrt(A / B)
    phi = np.log(ratio * np.tanh(mu * R * np.sqrt(A * B) * c + np.arctanh(1 / ratio))) / mu
    return np.asarray([phi, A * np.exp(-mu * phi), B * np.exp(mu * phi)])


def pull_against(held: float) -> Held:
    """Pull the left tendon from the held tension to PULL and back, the right one held."""
    robot = strung(held)
    up = np.linspace(held, PULL, STEPS + 1)
    left = np.concatenate([up, up[-2::-1]])
    run = simulate(robot, np.stack([left, np.full_like(left, held)], axis=1))
    return Held(
        held=held,
        run=run,
        top=STEPS,
        pulled=equilibrium_at(robot, run, STEPS),
        exact=closed_form(robot, PULL, held),
    )
