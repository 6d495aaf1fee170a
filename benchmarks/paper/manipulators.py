"""The two fabricated manipulators: what the published tensions say about what was not published.

Liu & Alambeigi give the body, the bores and two tensions each of TD-CM I and II; the offsets, the modulus and
the friction coefficient are missing. Two numbers determine two unknowns, so for each offset |r| a pair
(mu, E) is solved for: the tip tension pulled at 45 N, and the same tip tension released at T_base_switch
(Algorithm 1: the switch is where the releasing state has the tip tension of the pull, so no search for the
switch is needed). `release_switch`, which does search, confirms every pair.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from gtr_jax.config.config import RobotConfig, load_config
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.robot import STANDARD_GRAVITY, Robot
from gtr_jax.simulation.equilibrium import equilibrium
from gtr_jax.simulation.history import Simulation, simulate
from gtr_jax.simulation.release import ALL_RELEASED, release_switch

from .study import ROBOTS

T_MAX = 45.0
READINGS = np.arange(0.0, T_MAX + 1e-9, 5.0)
FINE_STEP = 0.05
OFFSET = 10e-3
OFFSET_BORE = 7e-3  # the bore's radius: with less, the tendon would hang in the bore
OFFSETS = np.arange(5.0, 12.6, 0.5) * 1e-3
FIRST_GUESS = (0.3, 0.8e6)


class Published(NamedTuple):
    """What the paper prints of one manipulator [N], and half a unit of its last digit [N]."""

    T_tip_max: float
    T_base_switch: float
    half_digit: float = 0.05


PUBLISHED = {"TD-CM I": Published(22.0, 11.9), "TD-CM II": Published(23.9, 15.0)}
ROBOT_FILES = {"TD-CM I": "tdcm-1.toml", "TD-CM II": "tdcm-2.toml"}
NAMES = tuple(PUBLISHED)
# Direction of gravity in the bending plane from the base tangent [rad]; the tendon bends to the left (+y).
GRAVITIES: Mapping[str, float | None] = {
    "no gravity": None,
    "pulled up": -np.pi / 2,
    "pulled down": np.pi / 2,
    "hanging": 0.0,
}


class Case(NamedTuple):
    """One manipulator in one setting, as traced numbers (SI); every field may carry a lane axis.

    w1, w2: ends of the solid stretch, which the paper's bores leave, and of the wave [m]. r1, r2: offsets
    [m]. gravity, gravity_angle: [m/s^2], [rad]. T_tip, T_switch: tensions to meet [N].
    """

    w1: Any
    w2: Any
    r1: Any
    r2: Any
    gravity: Any
    gravity_angle: Any
    T_tip: Any
    T_switch: Any


@functools.cache
def config_of(name: str) -> RobotConfig:
    """The robot file of one manipulator."""
    return load_config(ROBOTS / ROBOT_FILES[name])


@functools.cache
def template(loaded: bool) -> Robot:
    """One robot structure, and one compiled program, for both manipulators: the finer mesh of the two in each
    panel. `loaded` says whether gravity and tip forces may act.
    """
    robots = [build_robot(config_of(name)) for name in NAMES]
    intervals = tuple(map(max, *(robot.intervals for robot in robots)))
    return dataclasses.replace(robots[0], intervals=intervals, loaded=loaded, name="TD-CM")


def case_of(
    name: str,
    *,
    offset: float = OFFSET,
    gravity: str = "no gravity",
    reading: tuple[float, float] = (0.0, 0.0),
) -> Case:
    """A manipulator with r1 = -offset, r2 = +offset [m]; `reading` is added to the published tensions [N]."""
    routing, published, angle = config_of(name).routing, PUBLISHED[name], GRAVITIES[gravity]
    assert routing.kind == "straight-sine-straight"
    return Case(
        w1=routing.w1,
        w2=routing.w2,
        r1=-offset,
        r2=offset,
        gravity=0.0 if angle is None else STANDARD_GRAVITY,
        gravity_angle=angle or 0.0,
        T_tip=published.T_tip_max + reading[0],
        T_switch=published.T_base_switch + reading[1],
    )


def stacked(cases: list[Case]) -> Case:
    """Cases along a lane axis."""
    return Case(*(jnp.asarray(column, float) for column in zip(*cases, strict=True)))


def robot_of(body: Robot, case: Case, mu, E) -> Robot:
    """The robot of a case, as a change of numbers in a template."""
    robot = body.with_values(
        mu=mu,
        E=E,
        r1=case.r1,
        r2=case.r2,
        w1=case.w1,
        w2=case.w2,
        bore_0_to=case.w1,
        bore_1_from=case.w2,
        gravity_angle=case.gravity_angle,
    )
    return eqx.tree_at(lambda r: r.loads.gravity, robot, jnp.asarray(case.gravity, float))


def _tip_tensions(robot: Robot, released: list) -> Float[Array, " tensions"]:
    """Tip tension pulled at 45 N, then fully released (lambda = -1 everywhere) at each base tension [N]."""
    nodes = sum(robot.intervals) + len(robot.intervals)
    high = [jnp.full(nodes, ALL_RELEASED * T_MAX)] * len(released)
    states = jax.vmap(lambda T_base, memory: equilibrium(robot, T_base, memory=memory, with_terms=False))(
        jnp.stack([jnp.asarray(T_MAX), *released]), jnp.stack([jnp.zeros(nodes), *high])
    )
    return states.T_tip


class Pair(NamedTuple):
    """Friction coefficient [-] and modulus [Pa] that meet both published tensions; `error` is what the search
    left, relative; `T_tip_max`, `T_base_switch` [N] and `converged` are `release_switch`'s own answer;
    `tip_angle` [rad], `wrap` [rad] and `tendon_length` [m] those pulled at 45 N.
    """

    mu: Any
    E: Any
    error: Any
    T_tip_max: Any
    T_base_switch: Any
    converged: Any
    tip_angle: Any
    wrap: Any
    tendon_length: Any


@eqx.filter_jit
def solve_pairs(body: Robot, cases: Case) -> Pair:
    """(mu, E) of every case (one lane each) on the template `body`, by Levenberg and Marquardt's method in
    their logarithms.
    """

    def missed(logs, case):
        mu, E = jnp.exp(logs)
        return jnp.log(_tip_tensions(robot_of(body, case, mu, E), [case.T_switch]) / case.T_tip)

    def one(case):
        solver = optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10)
        start = jnp.log(jnp.asarray(FIRST_GUESS))
        found = optx.least_squares(missed, solver, start, args=case, max_steps=80, throw=False)
        mu, E = jnp.exp(found.value)
        robot = robot_of(body, case, mu, E)
        switch = release_switch(robot, T_MAX)
        pulled = equilibrium(robot, T_MAX, with_terms=False)
        error = jnp.max(jnp.abs(missed(found.value, case)))
        return Pair(
            mu=mu,
            E=E,
            error=error,
            T_tip_max=switch.T_tip,
            T_base_switch=switch.T_base,
            converged=switch.converged & pulled.converged & (error < 1e-6),
            tip_angle=pulled.angle[-1],
            wrap=pulled.wrap[-1],
            tendon_length=pulled.tendon_length,
        )

    return jax.vmap(one)(cases)


class Family(NamedTuple):
    """The solved pairs, in numpy.

    `pairs` by (name, gravity): fields (offsets,). `corners` by name: fields (4,), the readings at the ends of
    their rounding, no gravity, |r| = 10 mm; `coarse` the same if "15 N" is rounded to 1 N.
    """

    pairs: dict[tuple[str, str], Pair]
    corners: dict[str, Pair]
    coarse: Pair

    def pair(self, name: str, gravity: str = "no gravity") -> Pair:
        """The pair at |r| = 10 mm."""
        at = int(np.argmin(np.abs(OFFSETS - OFFSET)))
        return Pair(*(field[at] for field in self.pairs[name, gravity]))


def _corners(name: str, halves: tuple[float, float]) -> list[Case]:
    signs = [(a, b) for a in (-1, 1) for b in (-1, 1)]
    return [case_of(name, reading=(a * halves[0], b * halves[1])) for a, b in signs]


@functools.cache
def family() -> Family:
    """Every pair that the studies need, in one batch."""
    keys = [(name, gravity) for name in NAMES for gravity in GRAVITIES]
    lanes = [case_of(name, offset=r, gravity=gravity) for name, gravity in keys for r in OFFSETS]
    for name in NAMES:
        half = PUBLISHED[name].half_digit
        lanes += _corners(name, (half, half))
    lanes += _corners("TD-CM II", (PUBLISHED["TD-CM II"].half_digit, 0.5))
    solved = jax.tree_util.tree_map(np.asarray, solve_pairs(template(True), stacked(lanes)))

    def part(start: int, count: int) -> Pair:
        return Pair(*(field[start : start + count] for field in solved))

    many = len(OFFSETS)
    after = len(keys) * many
    return Family(
        pairs={key: part(i * many, many) for i, key in enumerate(keys)},
        corners={name: part(after + 4 * i, 4) for i, name in enumerate(NAMES)},
        coarse=part(after + 8, 4),
    )


SHARED_OFFSETS = np.arange(7.0, 12.1, 1.0) * 1e-3  # |r| of I: outside the bore, inside the surface at the tip
SHARED_LEADS = np.array([0.0, -1.0, 1.0, 2.0]) * 1e-3  # |r| of II beyond it
WIDEST = 12.5e-3
NEARBY = 1.01
PASSES = 3


class Shared(NamedTuple):
    """One (mu, E) for both manipulators that comes closest to the four published tensions, for given offsets.

    mu [-], E [Pa]; T_tip_max, T_base_switch [N] with a last axis (I, II); `rms` the root mean square relative
    error of the four; `converged` whether the equilibria solve and the switch is one.
    """

    mu: Any
    E: Any
    T_tip_max: Any
    T_base_switch: Any
    rms: Any
    converged: Any


@eqx.filter_jit
def _fit_shared(body: Robot, cases: Case, logs: Array, near: Array) -> Shared:
    """Least squares of the four relative errors; the cases have the axes (lanes, 2).

    The search judges the switch by one Newton step from a tension near it; what it ends on is
    `release_switch`'s. Repeated from there, it minimises the errors themselves.

    Args:
        body: the template.
        cases: both manipulators in every lane.
        logs: where to start, logarithms of (mu, E), (lanes, 2).
        near: base tensions near the switches [N], (lanes, 2).
    """

    def judged(robot, case, near):
        T_tip, here, further = _tip_tensions(robot, [near, NEARBY * near])
        slope = jnp.log(further / here) / jnp.log(NEARBY)
        T_switch = near * jnp.exp(jnp.log(T_tip / here) / slope)
        return jnp.stack([T_tip / case.T_tip, T_switch / case.T_switch]) - 1.0

    def missed(logs, args):
        mu, E = jnp.exp(logs)
        return jax.vmap(lambda c, n: judged(robot_of(body, c, mu, E), c, n))(*args).ravel()

    def one(case, logs, near):
        solver = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-8)
        found = optx.least_squares(missed, solver, logs, args=(case, near), max_steps=40, throw=False)
        mu, E = jnp.exp(found.value)
        switch = jax.vmap(lambda c: release_switch(robot_of(body, c, mu, E), T_MAX))(case)
        errors = jnp.stack([switch.T_tip / case.T_tip, switch.T_base / case.T_switch]) - 1.0
        solved = (found.result == optx.RESULTS.successful) & jnp.all(switch.converged)
        return Shared(mu, E, switch.T_tip, switch.T_base, jnp.sqrt(jnp.mean(errors**2)), solved)

    return jax.vmap(one)(cases, logs, near)


@functools.cache
def shared_fits() -> Shared:
    """Fits with one silicone, in numpy, with the axes (gravity, SHARED_OFFSETS, SHARED_LEADS)."""
    lanes = [
        stacked([case_of(NAMES[0], offset=r, gravity=g), case_of(NAMES[1], offset=second, gravity=g)])
        for g in GRAVITIES
        for r in SHARED_OFFSETS
        for second in np.clip(r + SHARED_LEADS, None, WIDEST)
    ]
    cases = jax.tree_util.tree_map(lambda *fields: jnp.stack(fields), *lanes)
    logs = jnp.broadcast_to(jnp.log(jnp.asarray(FIRST_GUESS)), (len(lanes), 2))
    fits = _fit_shared(template(True), cases, logs, cases.T_switch)
    for _ in range(PASSES - 1):
        logs = jnp.log(jnp.stack([fits.mu, fits.E], axis=1))
        fits = _fit_shared(template(True), cases, logs, fits.T_base_switch)
    axes = (len(GRAVITIES), len(SHARED_OFFSETS), len(SHARED_LEADS))
    return Shared(*(np.asarray(field).reshape(*axes, *field.shape[1:]) for field in fits))


def solved_robot(name: str, *, loaded: bool = False) -> Robot:
    """A manipulator with |r| = 10 mm and its solved pair, without gravity."""
    pair = family().pair(name)
    return robot_of(template(loaded), case_of(name), float(pair.mu), float(pair.E))


def solved_config(name: str) -> RobotConfig:
    """The same as a robot file."""
    pair = family().pair(name)
    values = {"tendon.friction_coefficient": float(pair.mu), "backbone.youngs_modulus": float(pair.E)}
    return config_of(name).with_values(values)


@functools.cache
def pulled_and_released(name: str, mu: float | None = None) -> Simulation:
    """0 to 45 N and back in fine steps, |r| = 10 mm, no gravity, with the solved pair or another mu."""
    robot = solved_robot(name)
    robot = robot if mu is None else robot.with_values(mu=mu)
    up = np.linspace(0.0, T_MAX, round(T_MAX / FINE_STEP) + 1)
    return simulate(robot, jnp.asarray(np.concatenate([up, up[-2::-1]])))


def switch_backward(robot: Robot, T_tip: float, *, tolerance: float = 1e-10) -> tuple[float, int]:
    """T_base_switch as the paper suggests: (18) with lambda = -1 everywhere and T_tip_max at the tip, the
    base tension following as T_tip_max exp(-mu theta(L)) until it stays. Returns it [N] and the solutions
    taken.
    """
    nodes = sum(robot.intervals) + len(robot.intervals)
    memory = jnp.full(nodes, ALL_RELEASED * T_MAX)
    mu, T_base = float(robot.tendon.friction_coefficient), T_tip
    for count in range(1, 200):
        before = T_base
        T_base = T_tip * float(np.exp(-mu * float(equilibrium(robot, T_base, memory=memory).wrap[-1])))
        if abs(T_base - before) < tolerance:
            return T_base, count
    return float("nan"), count
