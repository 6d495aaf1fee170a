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
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from gtr_jax.build import build_robot
from gtr_jax.config import RobotConfig, config_text, load_config
from gtr_jax.equilibrium import equilibrium, rest_state, tendon_length
from gtr_jax.history import Simulation, simulate
from gtr_jax.phases import ALL_RELEASED, PULLING, RELEASING, TRANSITION, label_phases, release_switch
from gtr_jax.plots.style import number, png
from gtr_jax.report.page import Figure, Table
from gtr_jax.robot import STANDARD_GRAVITY, Robot, sections

from . import manipulator_figures as draw
from .study import Statement, Study

FILES = Path(__file__).parent.parent / "examples" / "paper"
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
    return load_config(FILES / ROBOT_FILES[name])


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
    states = jax.vmap(lambda T_base, memory: equilibrium(robot, T_base, memory=memory))(
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
        pulled = equilibrium(robot, T_MAX)
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
def _pulled_and_released(name: str, mu: float | None = None) -> Simulation:
    """0 to 45 N and back in fine steps, |r| = 10 mm, no gravity, with the solved pair or another mu."""
    robot = solved_robot(name)
    robot = robot if mu is None else robot.with_values(mu=mu)
    up = np.linspace(0.0, T_MAX, round(T_MAX / FINE_STEP) + 1)
    return simulate(robot, jnp.asarray(np.concatenate([up, up[-2::-1]])))


def _switch_backward(robot: Robot, T_tip: float, *, tolerance: float = 1e-10) -> tuple[float, int]:
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


def _mm(metres: float) -> str:
    return number(1e3 * metres, "mm", 3)


def _loop_facts(name: str) -> dict[str, Any]:
    """The loop's numbers, and the three ways to T_base_switch."""
    robot, run = solved_robot(name), _pulled_and_released(name)
    phases = label_phases(run)
    T_base, T_tip = np.asarray(run.T_base), np.asarray(run.T_tip)
    moving = phases == TRANSITION
    switch = release_switch(robot, T_MAX)
    backward, solutions = _switch_backward(robot, float(switch.T_tip))
    straight = robot.with_values(r1=robot.value("r2"))
    straight_switch = release_switch(straight, T_MAX)
    pulled, straight_pulled = equilibrium(robot, T_MAX), equilibrium(straight, T_MAX)
    rest = sections(robot)
    return {
        "phases": list(dict.fromkeys(phases.tolist())),
        "converged": bool(np.all(np.asarray(run.converged))) and bool(switch.converged),
        "T_tip_max_N": float(T_tip.max()),
        "T_tip_spread_in_transition_N": float(np.ptp(T_tip[moving])),
        "T_base_switch_release_switch_N": float(switch.T_base),
        "T_base_switch_backward_N": backward,
        "backward_solutions": solutions,
        "T_base_switch_fine_steps_N": float(T_base[moving].min()),
        "fine_step_N": FINE_STEP,
        "tension_loss_at_45_N": 1.0 - float(T_tip.max()) / T_MAX,
        "tip_angle_at_45_N_deg": float(np.degrees(pulled.angle[-1])),
        "wrap_at_45_N_rad": float(pulled.wrap[-1]),
        "tip_at_45_N_mm": [1e3 * float(pulled.x[-1]), 1e3 * float(pulled.y[-1])],
        "steepest_slope_of_channel": float(np.max(np.abs(rest.R.slope))),
        "channel_length_mm": 1e3 * float(tendon_length(rest, rest_state(rest))),
        "straight_routing_T_tip_max_N": float(straight_switch.T_tip),
        "straight_routing_T_base_switch_N": float(straight_switch.T_base),
        "straight_routing_wrap_at_45_N_rad": float(straight_pulled.wrap[-1]),
        "readings_pulling_N": T_tip[:: round(5.0 / FINE_STEP)][: len(READINGS)].tolist(),
        "readings_releasing_N": T_tip[:: round(5.0 / FINE_STEP)][len(READINGS) - 1 :].tolist(),
    }


def _span(values) -> str:
    return f"{number(float(np.min(values)), digits=3)} to {number(float(np.max(values)), digits=3)}"


def _shared_best(fits: Shared, gravity: int, *, same: bool) -> tuple[float, float, Shared]:
    """The best fit of one gravity: |r| of I and II [m] and the fit; `same`: with one |r|."""
    allowed = fits.converged[gravity] & (np.asarray(SHARED_LEADS == 0.0)[None, :] if same else True)
    i, j = np.unravel_index(np.argmin(np.where(allowed, fits.rms[gravity], np.inf)), fits.rms[gravity].shape)
    first = float(SHARED_OFFSETS[i])
    second = min(first + float(SHARED_LEADS[j]), WIDEST)
    return first, second, Shared(*(field[gravity, i, j] for field in fits))


def _equal_wraps(fit: Shared, offset: float) -> list[tuple[float, float]]:
    """Wrap [rad] and tension loss of I and II at 45 N with one mu, E and |r|, no gravity."""
    states = [
        equilibrium(robot_of(template(False), case_of(name, offset=offset), fit.mu, fit.E), T_MAX)
        for name in NAMES
    ]
    return [(float(eq.wrap[-1]), 1.0 - float(eq.T_tip) / T_MAX) for eq in states]


def _family_table(solved: Family) -> Table:
    rows = []
    for (name, gravity), pairs in solved.pairs.items():
        pair = solved.pair(name, gravity)
        rows.append(
            [
                name,
                gravity,
                number(float(pair.mu), digits=3),
                number(1e-6 * float(pair.E), "MPa", 3),
                number(float(np.degrees(pair.tip_angle)), "°", 3),
                _span(pairs.mu),
                f"{_span(1e-6 * pairs.E)} MPa",
                f"{_span(np.degrees(pairs.tip_angle))}°",
            ]
        )
    ends = f"|r| = {1e3 * OFFSETS[0]:g} to {1e3 * OFFSETS[-1]:g} mm"
    at = f"|r| = {1e3 * OFFSET:g} mm"
    return Table(
        "μ and E that meet both published tensions, and the tip angle they give at 45 N",
        ["", "gravity", f"μ at {at}", "E", "tip", f"μ at {ends}", "E", "tip"],
        rows,
        "Pulled up: base tangent horizontal, bending plane vertical, the tendon lifts the tip; pulled down: "
        "it "
        "lowers it; hanging: base tangent down. Density 1070 kg/m³ is ours (a silicone).",
    )


def _shared_table(fits: Shared) -> tuple[Table, list[dict[str, Any]]]:
    rows, facts = [], []
    for g, gravity in enumerate(GRAVITIES):
        for same in (True, False):
            first, second, fit = _shared_best(fits, g, same=same)
            published = np.asarray([PUBLISHED[name] for name in NAMES])[:, :2]
            ours = np.stack([fit.T_tip_max, fit.T_base_switch], axis=1)
            errors = ours - published
            facts.append(
                {
                    "gravity": gravity,
                    "one_offset": same,
                    "offset_I_m": first,
                    "offset_II_m": second,
                    "mu": float(fit.mu),
                    "E_Pa": float(fit.E),
                    "T_tip_max_N": fit.T_tip_max.tolist(),
                    "T_base_switch_N": fit.T_base_switch.tolist(),
                    "rms_relative_error": float(fit.rms),
                    "largest_error_N": float(np.max(np.abs(errors))),
                    "largest_relative_error": float(np.max(np.abs(errors / published))),
                }
            )
            pairs = (f"{tip:.1f} / {switch:.1f}" for tip, switch in ours)
            offsets = _mm(first) if same else f"{_mm(first)}, {_mm(second)}"
            rows.append(
                [
                    gravity,
                    offsets,
                    number(float(fit.mu), digits=3),
                    number(1e-6 * float(fit.E), "MPa", 3),
                    *pairs,
                    f"{100 * float(fit.rms):.1f} %",
                    f"{np.max(np.abs(errors)):.1f} N, {100 * np.max(np.abs(errors / published)):.1f} %",
                ]
            )
    table = Table(
        "One silicone for both: the closest that one μ and one E come to the four published tensions",
        ["gravity", "|r|", "μ", "E", "I [N]", "II [N]", "rms", "largest"],
        rows,
        "Published: "
        + ", ".join(f"{n} {p.T_tip_max:g} / {p.T_base_switch:g} N" for n, p in PUBLISHED.items())
        + " (T_tip_max / T_base_switch). First row of each: one |r| for both; second: |r| of each "
        f"({1e3 * SHARED_OFFSETS[0]:g} to {1e3 * WIDEST:g} mm, 1 mm steps). "
        f"{int(fits.converged.sum())} of {fits.converged.size} fits settled; "
        "only these are compared.",
    )
    return table, facts


def _corner_spans(solved: Family) -> dict[str, dict[str, list[float]]]:
    named = {**solved.corners, "TD-CM II, switch to 1 N": solved.coarse}
    return {
        name: {
            "mu": [float(pair.mu.min()), float(pair.mu.max())],
            "E_Pa": [float(pair.E.min()), float(pair.E.max())],
        }
        for name, pair in named.items()
    }


def _statements(solved: Family, loops: dict[str, dict], equal: list[tuple[float, float]]) -> list[Statement]:
    one, two = (loops[name] for name in NAMES)
    both = [(name, loops[name]) for name in NAMES]

    def each(text: Callable[[dict], str]) -> str:
        return "; ".join(f"{name}: {text(facts)}" for name, facts in both)

    order = [PULLING, TRANSITION, RELEASING]
    wall = OFFSETS > OFFSET_BORE - 1e-9
    angles = {n: np.degrees(solved.pairs[n, "no gravity"].tip_angle[wall]) for n in NAMES}
    met = all(
        abs(f["T_tip_max_N"] - PUBLISHED[n].T_tip_max) < PUBLISHED[n].half_digit
        and abs(f["T_base_switch_release_switch_N"] - PUBLISHED[n].T_base_switch) < PUBLISHED[n].half_digit
        for n, f in both
    )
    own_wraps = one["wrap_at_45_N_rad"] > two["wrap_at_45_N_rad"]
    ways = max(abs(f["T_base_switch_backward_N"] - f["T_base_switch_release_switch_N"]) for _, f in both)
    steps = max(abs(f["T_base_switch_fine_steps_N"] - f["T_base_switch_release_switch_N"]) for _, f in both)
    return [
        Statement(
            "T_tip stays at its maximum through the transition: 22.0 N (I), 23.9 N (II), for 45 N at the "
            "base.",
            each(
                lambda f: (
                    f"{f['T_tip_max_N']:.2f} N, constant within {f['T_tip_spread_in_transition_N']:.0e} N"
                )
            )
            + " (μ and E are solved so that the level is met; that it is constant follows).",
            met and all(f["T_tip_spread_in_transition_N"] < 1e-9 for _, f in both),
        ),
        Statement(
            "Release reaches the tip at T_base_switch = 11.9 N (I) and 15 N (II).",
            each(lambda f: f"{f['T_base_switch_release_switch_N']:.2f} N")
            + f", met by some μ and E at every |r| from {_mm(OFFSETS[0])} to {_mm(OFFSETS[-1])}, with and "
            "without gravity.",
            met and all(bool(np.all(p.converged)) for p in solved.pairs.values()),
        ),
        Statement(
            "Algorithm 1 captures three phases, in the order pulling, transition, releasing.",
            each(lambda f: ", ".join(f["phases"])) + ".",
            all([p for p in f["phases"] if p != "rest"] == order for _, f in both),
        ),
        Statement(
            "T_base_switch can be had by solving (18) backward with λ = −1 from T_tip_max.",
            each(
                lambda f: (
                    f"backward {f['T_base_switch_backward_N']:.4f} N in {f['backward_solutions']} solutions, "
                    f"our search {f['T_base_switch_release_switch_N']:.4f} N, the history in {FINE_STEP:g} "
                    "N steps "
                    f"{f['T_base_switch_fine_steps_N']:.2f} N"
                )
            )
            + ".",
            ways < 1e-6 and steps <= FINE_STEP,
        ),
        Statement(
            "Path I is steeper than path II because its wave is shorter.",
            each(lambda f: f"largest |dR/ds| {f['steepest_slope_of_channel']:.3f}") + " (at equal |r|).",
            one["steepest_slope_of_channel"] > two["steepest_slope_of_channel"],
        ),
        Statement(
            "Wrap angle and curvature of path I are larger than those of path II, which explains its larger "
            "loss.",
            f"With one μ, E and |r| for both: wrap at 45 N {equal[0][0]:.2f} rad (I) and {equal[1][0]:.2f} "
            "rad (II), "
            f"loss {100 * equal[0][1]:.1f} % and {100 * equal[1][1]:.1f} %. With each its own pair, which "
            "meets the "
            f"published tensions exactly at |r| = {_mm(OFFSET)}, {one['wrap_at_45_N_rad']:.2f} and "
            f"{two['wrap_at_45_N_rad']:.2f} rad: "
            f"{'the same order' if own_wraps else 'then μ makes the difference'}.",
            equal[0][0] > equal[1][0],
        ),
        Statement(
            "I loses more tension than II; the loss is about 50 %.",
            each(lambda f: f"{100 * f['tension_loss_at_45_N']:.1f} %") + ".",
            one["tension_loss_at_45_N"] > two["tension_loss_at_45_N"] > 0.4,
        ),
        Statement(
            "I and II deform differently under the same base tension.",
            each(lambda f: f"tip turned {f['tip_angle_at_45_N_deg']:.0f}° at 45 N") + " (|r| = 10 mm).",
            abs(one["tip_angle_at_45_N_deg"] - two["tip_angle_at_45_N_deg"]) > 5,
        ),
        Statement(
            "The transition is larger than with straight routing; partly because the tendon is longer.",
            "In the same body: "
            + each(
                lambda f: (
                    f"transition {T_MAX - f['T_base_switch_release_switch_N']:.1f} N wide against "
                    f"{T_MAX - f['straight_routing_T_base_switch_N']:.1f} N for a straight channel at r₂; "
                    f"the channel is {100 * (f['channel_length_mm'] / 250.0 - 1):.1f} % longer than the body"
                )
            )
            + ". A straight channel at r₂ bends the whole body one way and so wraps too: "
            + each(
                lambda f: (
                    f"{f['wrap_at_45_N_rad']:.2f} rad with the wave, "
                    f"{f['straight_routing_wrap_at_45_N_rad']:.2f} rad straight, at 45 N"
                )
            )
            + ". (The paper compares with other manipulators, of its reference [8].)",
            all(f["T_base_switch_release_switch_N"] < f["straight_routing_T_base_switch_N"] for _, f in both),
        ),
        Statement(
            "Agreement in tensions indirectly shows that the shape is predicted.",
            "; ".join(
                f"{n}: pairs that meet both tensions turn the tip by {_span(a)}° at 45 N as |r| goes from "
                f"{_mm(OFFSET_BORE)} to {_mm(OFFSETS[-1])}"
                for n, a in angles.items()
            )
            + ". The two tensions alone do not fix the shape; a known |r| does.",
            not all(float(np.ptp(a)) > 10 for a in angles.values()),
        ),
        Statement(
            "Mean absolute percentage error over 120 readings: 9.98 % (I), 7.10 % (II).",
            "The readings are not published; nothing to compare with.",
            None,
        ),
    ]


def study_manipulators(progress: Callable[[str], None]) -> Study:
    """The two fabricated manipulators: what their published tensions determine.

    Args:
        progress: told each stage.
    """
    progress("TD-CM I and II: friction and modulus for every offset")
    solved = family()
    progress("TD-CM I and II: one silicone for both")
    fits = shared_fits()
    progress("TD-CM I and II: loops")
    loops = {name: _loop_facts(name) for name in NAMES}
    equal_offset, _, equal_fit = _shared_best(fits, 0, same=True)
    equal = _equal_wraps(equal_fit, equal_offset)
    shared_table, shared_facts = _shared_table(fits)
    spans = _corner_spans(solved)
    lanes = sum(len(p.mu) for p in solved.pairs.values())
    met = sum(int(p.converged.sum()) for p in solved.pairs.values())
    same = next(f for f in shared_facts if f["one_offset"] and f["gravity"] == "no gravity")
    best = min(shared_facts, key=lambda f: f["rms_relative_error"])
    flat = fits.rms[0, :, 0]
    free = solved.pairs[NAMES[0], "no gravity"]
    text = [
        "The paper gives the bodies, the bores and two tensions each; r₁, r₂, E and μ are missing. We take "
        "r₁ = −|r|, "
        "r₂ = +|r|, the wave between the bores, and solve for the pair (μ, E) that meets both tensions: "
        f"{met} of {lanes} cases (|r|, gravity, manipulator) are met, each confirmed by a search for the "
        "switch. "
        "Only 7 to 13 mm lie in the wall: below, the tendon would hang in the 14 mm bore; above, it would "
        "leave "
        "the surface at the tip.",
        f"Without gravity, from |r| = {_mm(OFFSETS[0])} to {_mm(OFFSETS[-1])} μ changes by a factor of "
        f"{_factor(free.mu):.1f} and E by {_factor(free.E):.2f} (TD-CM I). Gravity changes them by up to "
        f"{100 * _largest_change(solved, 'mu'):.0f} % and {100 * _largest_change(solved, 'E'):.0f} % at |r| "
        "= 10 mm, so the "
        "orientation of the rig, which the paper does not state, matters. The printed digits alone leave "
        + "; ".join(
            f"{name}: μ {_span(s['mu'])}, E {_span(1e-6 * np.asarray(s['E_Pa']))} MPa"
            for name, s in spans.items()
        )
        + " (|r| = 10 mm, no gravity).",
        f"One silicone can serve both: with one μ, one E and one |r| = {_mm(same['offset_I_m'])} the four "
        "tensions are met "
        f"within {same['largest_error_N']:.1f} N ({100 * same['largest_relative_error']:.1f} %), "
        f"{100 * same['rms_relative_error']:.1f} % rms, and every |r| does nearly as well "
        f"({100 * flat.min():.1f} to {100 * flat.max():.1f} %). With |r| of each the best is "
        f"{100 * best['rms_relative_error']:.1f} % rms ({best['gravity']}, {_mm(best['offset_I_m'])} and "
        f"{_mm(best['offset_II_m'])}). The paper's model leaves 7 to 10 % to its readings. Yet the "
        "two pairs at |r| = 10 mm differ by a factor of "
        f"{float(solved.pair('TD-CM I').E / solved.pair('TD-CM II').E):.1f} in E: two tensions hold E "
        "loosely.",
    ]
    figures = [
        Figure(
            "manipulator-family",
            png(draw.plot_family(OFFSETS, solved.pairs)),
            "μ and E that meet both published tensions, against the offset that is not published. Shaded: "
            "the tendon "
            "would lie in the bore.",
        ),
        Figure(
            "manipulator-loops",
            png(
                draw.plot_loops(
                    {n: _pulled_and_released(n) for n in NAMES},
                    {n: _pulled_and_released(n, 0.0) for n in NAMES},
                    {n: loops[n]["T_base_switch_release_switch_N"] for n in NAMES},
                    every=round(5.0 / FINE_STEP),
                )
            ),
            "Loops of TD-CM I and II at |r| = 10 mm. Rings: the paper's 5 N readings. ×: T_base,switch.",
        ),
    ]
    return Study(
        title="The two fabricated manipulators",
        text=text,
        statements=_statements(solved, loops, equal),
        figures=figures,
        tables=[_family_table(solved), shared_table],
        facts={
            "offsets_m": OFFSETS.tolist(),
            "published_N": {n: p._asdict() for n, p in PUBLISHED.items()},
            "family": {
                f"{name}, {gravity}": {
                    "mu": p.mu.tolist(),
                    "E_Pa": p.E.tolist(),
                    "tip_angle_rad": p.tip_angle.tolist(),
                    "wrap_rad": p.wrap.tolist(),
                    "converged": p.converged.tolist(),
                }
                for (name, gravity), p in solved.pairs.items()
            },
            "one_silicone": shared_facts,
            "one_silicone_fits": {"solved": int(fits.converged.sum()), "of": int(fits.converged.size)},
            "rounding_of_readings": spans,
            "loops": loops,
            "equal_parameters": {
                "wrap_rad": [wrap for wrap, _ in equal],
                "tension_loss": [loss for _, loss in equal],
            },
        },
        robots={ROBOT_FILES[name]: config_text(solved_config(name)) for name in NAMES},
    )


def _factor(values: np.ndarray) -> float:
    """Largest over smallest."""
    return float(np.max(values) / np.min(values))


def _largest_change(solved: Family, field: str) -> float:
    """Largest relative change of a pair's field by gravity, at |r| = 10 mm."""
    changes = [
        getattr(solved.pair(name, gravity), field) / getattr(solved.pair(name), field) - 1
        for name in NAMES
        for gravity in GRAVITIES
    ]
    return float(np.max(np.abs(changes)))
