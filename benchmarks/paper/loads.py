"""External loads on TD-CM I: what a tip force, the direction of gravity and a payload do to tension loss.

Every point is its own robot under its own dead load, pulled from slack to 45 N; one compiled program solves
them all. Loads stand before the tendon is pulled. The friction law compares tensions at a changing base
tension; it does not follow the slip that a load put on later would cause, so loads that change are left
alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gtr_jax.report.page import Figure, Table
from gtr_jax.robot.robot import STANDARD_GRAVITY, Robot
from gtr_jax.simulation.equilibrium import equilibrium
from gtr_jax.simulation.history import simulate
from gtr_jax.simulation.release import release_switch

from . import manipulator_figures as draw
from .manipulators import GRAVITIES, T_MAX, solved_robot
from .study import Study, beyond

FORCES = np.linspace(0.0, 1.0, 21)
# Unit vectors in the frame of the base; the tendon bends the body to the left (+y).
DIRECTIONS: dict[str, tuple[float, float]] = {
    "with the bend (+y)": (0.0, 1.0),
    "against the bend (−y)": (0.0, -1.0),
    "outward along the base (+x)": (1.0, 0.0),
    "inward along the base (−x)": (-1.0, 0.0),
}
ANGLES = np.radians(np.arange(0.0, 360.1, 5.0))
MASSES = np.linspace(0.0, 0.1, 6)
LOOP = np.concatenate([np.linspace(0.0, T_MAX, 181), np.linspace(T_MAX, 0.0, 181)[1:]])


class Load(NamedTuple):
    """One load; every field may carry a lane axis: tip force [N], gravity [m/s^2] and its direction [rad]."""

    tip_force_x: Any = 0.0
    tip_force_y: Any = 0.0
    gravity: Any = 0.0
    gravity_angle: Any = 0.0


class Point(NamedTuple):
    """What one load gives at 45 N: tip tension [N], T_base_switch [N], tip angle [rad], wrap [rad];
    `converged` whether all of it is solved.
    """

    T_tip: Any
    T_base_switch: Any
    tip_angle: Any
    wrap: Any
    converged: Any


def stacked(loads: Sequence[Load]) -> Load:
    """Loads along a lane axis."""
    return Load(*(jnp.asarray(column, float) for column in zip(*loads, strict=True)))


def under(robot: Robot, load: Load) -> Robot:
    """The robot under a load, as a change of numbers."""
    robot = robot.with_values(
        tip_force_x=load.tip_force_x, tip_force_y=load.tip_force_y, gravity_angle=load.gravity_angle
    )
    return eqx.tree_at(lambda r: r.loads.gravity, robot, jnp.asarray(load.gravity, float))


@eqx.filter_jit
def solve_loads(robot: Robot, loads: Load) -> Point:
    """All loads at 45 N, one lane each; `robot` must be built as loaded."""

    def one(load):
        mine = under(robot, load)
        pulled = equilibrium(mine, T_MAX, with_terms=False)
        switch = release_switch(mine, T_MAX)
        return Point(
            T_tip=pulled.T_tip,
            T_base_switch=switch.T_base,
            tip_angle=pulled.angle[-1],
            wrap=pulled.wrap[-1],
            converged=pulled.converged & switch.converged,
        )

    return jax.vmap(one)(loads)


def _slope_at_zero(points: Point, field: str) -> float:
    """Change per newton over the first step of the force."""
    values = getattr(points, field)
    return float((values[1] - values[0]) / (FORCES[1] - FORCES[0]))


def _force_facts(points: Point) -> dict[str, Any]:
    finite = np.asarray(points.converged)
    last = int(np.flatnonzero(finite)[-1])
    return {
        "T_tip_N": points.T_tip.tolist(),
        "T_base_switch_N": points.T_base_switch.tolist(),
        "tip_angle_rad": points.tip_angle.tolist(),
        "converged": points.converged.tolist(),
        "dT_tip_per_N": _slope_at_zero(points, "T_tip"),
        "dT_base_switch_per_N": _slope_at_zero(points, "T_base_switch"),
        "dtip_angle_deg_per_N": float(np.degrees(_slope_at_zero(points, "tip_angle"))),
        "largest_force_N": float(FORCES[last]),
        "T_tip_change_at_largest_N": float(points.T_tip[last] - points.T_tip[0]),
        "T_base_switch_change_at_largest_N": float(points.T_base_switch[last] - points.T_base_switch[0]),
        "tip_angle_change_at_largest_deg": float(np.degrees(points.tip_angle[last] - points.tip_angle[0])),
    }


def _force_table(forces: dict[str, dict[str, Any]]) -> Table:
    rows = []
    for name, f in forces.items():
        rows.append(
            [
                name,
                f"{f['dT_tip_per_N']:+.2f}",
                f"{f['dT_base_switch_per_N']:+.2f}",
                f"{f['dtip_angle_deg_per_N']:+.0f}°",
                f"{f['T_tip_change_at_largest_N']:+.2f}",
                f"{f['T_base_switch_change_at_largest_N']:+.2f}",
                f"{f['tip_angle_change_at_largest_deg']:+.0f}°",
            ]
        )
    largest = min(f["largest_force_N"] for f in forces.values())
    return Table(
        f"A tip force on TD-CM I at {T_MAX:g} N: per newton near zero, and at {largest:g} N",
        [
            "force on the tip",
            "ΔT_tip per N",
            "ΔT_switch per N",
            "Δangle per N",
            "ΔT_tip [N]",
            "ΔT_switch [N]",
            "Δangle",
        ],
        rows,
    )


def _payload_table(payload: dict[str, Point]) -> Table:
    rows = [
        [
            gravity,
            f"{1e3 * mass:.0f} g",
            f"{points.T_tip[i]:.2f}",
            f"{points.T_base_switch[i]:.2f}",
            f"{np.degrees(points.tip_angle[i]):.1f}°",
        ]
        for gravity, points in payload.items()
        for i, mass in enumerate(MASSES)
        if i in (0, len(MASSES) // 2, len(MASSES) - 1)
    ]
    return Table(
        f"A mass at the tip, with the body's weight, at {T_MAX:g} N",
        ["gravity", "mass", "T_tip [N]", "T_base_switch [N]", "tip angle"],
        rows,
    )


def study_loads(progress: Callable[[str], None]) -> Study:
    """External loads and tension loss, on TD-CM I at |r| = 10 mm with the pair solved without gravity.

    Args:
        progress: told each stage.
    """
    progress("external loads: tip forces, gravity, payloads")
    robot = solved_robot("TD-CM I", loaded=True)
    turned = {name: angle for name, angle in GRAVITIES.items() if angle is not None}
    lanes = [Load(force * x, force * y) for x, y in DIRECTIONS.values() for force in FORCES]
    lanes += [Load(gravity=STANDARD_GRAVITY, gravity_angle=angle) for angle in ANGLES]
    for angle in turned.values():
        for mass in MASSES:
            weight = mass * STANDARD_GRAVITY
            lanes.append(Load(weight * np.cos(angle), weight * np.sin(angle), STANDARD_GRAVITY, angle))
    solved = jax.tree_util.tree_map(np.asarray, solve_loads(robot, stacked(lanes)))

    def part(start: int, count: int) -> Point:
        return Point(*(field[start : start + count] for field in solved))

    points = {name: part(i * len(FORCES), len(FORCES)) for i, name in enumerate(DIRECTIONS)}
    start = len(DIRECTIONS) * len(FORCES)
    gravity = part(start, len(ANGLES))
    start += len(ANGLES)
    payload = {name: part(start + i * len(MASSES), len(MASSES)) for i, name in enumerate(turned)}
    unloaded = part(0, 1)

    progress("external loads: loops")
    loop_loads = {
        "no load": Load(),
        "1 N with the bend": Load(tip_force_y=1.0),
        "1 N against it": Load(tip_force_y=-1.0),
        "weight, pulled up": Load(gravity=STANDARD_GRAVITY, gravity_angle=turned["pulled up"]),
        "weight, pulled down": Load(gravity=STANDARD_GRAVITY, gravity_angle=turned["pulled down"]),
    }
    runs = {name: simulate(under(robot, load), jnp.asarray(LOOP)) for name, load in loop_loads.items()}

    forces = {name: _force_facts(p) for name, p in points.items()}
    facts = {
        "T_base_N": T_MAX,
        "force_N": FORCES.tolist(),
        "tip_force": forces,
        "gravity": {
            "angle_rad": ANGLES.tolist(),
            **{
                key: getattr(gravity, field).tolist()
                for key, field in (
                    ("T_tip_N", "T_tip"),
                    ("T_base_switch_N", "T_base_switch"),
                    ("tip_angle_rad", "tip_angle"),
                    ("wrap_rad", "wrap"),
                    ("converged", "converged"),
                )
            },
        },
        "payload": {
            name: {
                "mass_kg": MASSES.tolist(),
                "T_tip_N": p.T_tip.tolist(),
                "T_base_switch_N": p.T_base_switch.tolist(),
                "tip_angle_rad": p.tip_angle.tolist(),
                "dT_tip_per_100_g_N": float((p.T_tip[-1] - p.T_tip[0]) / (MASSES[-1] / 0.1)),
                "converged": p.converged.tolist(),
            }
            for name, p in payload.items()
        },
        "no_load": {
            "T_tip_N": float(unloaded.T_tip[0]),
            "T_base_switch_N": float(unloaded.T_base_switch[0]),
            "tip_angle_rad": float(unloaded.tip_angle[0]),
        },
        "loops_converged": {name: bool(jnp.all(run.converged)) for name, run in runs.items()},
        "points": len(lanes),
        "points_converged": int(np.sum(solved.converged)),
    }
    best, worst = (int(pick(gravity.T_tip)) for pick in (np.argmax, np.argmin))
    spread = {key: float(np.ptp(getattr(gravity, key))) for key in ("T_tip", "T_base_switch", "tip_angle")}
    with_bend, against = (forces[name] for name in list(DIRECTIONS)[:2])
    largest = max(abs(f["dT_tip_per_N"]) for f in forces.values())
    steps = sum(len(run.T_base) for run in runs.values())
    solved_steps = sum(int(jnp.sum(run.converged)) for run in runs.values())
    text = [
        f"{facts['points_converged']} of {facts['points']} load cases and {solved_steps} of {steps} steps of "
        "the loops converged"
        + (
            "."
            if facts["points_converged"] == facts["points"]
            else "; the others are flagged in the numbers and left out."
        ),
        f"Near zero, a force with the bend changes T_tip by {with_bend['dT_tip_per_N']:+.2f} N per newton "
        f"and one against it by {against['dT_tip_per_N']:+.2f} N: the first adds wrap, the second takes it "
        f"away. At {with_bend['largest_force_N']:g} N they change it by "
        f"{with_bend['T_tip_change_at_largest_N']:+.2f} and {against['T_tip_change_at_largest_N']:+.2f} N "
        f"and turn the tip by {with_bend['tip_angle_change_at_largest_deg']:+.0f}° and "
        f"{against['tip_angle_change_at_largest_deg']:+.0f}°. The loads stand before the pull; one that "
        "comes on later drags the tendon through its channel, which a law of tensions alone does not follow.",
        f"Turning the rig changes T_tip by {spread['T_tip']:.2f} N, T_base_switch by "
        f"{spread['T_base_switch']:.2f} N and the tip angle by {np.degrees(spread['tip_angle']):.0f}°: most "
        f"tension arrives with gravity at {np.degrees(ANGLES[best]):.0f}° from the base tangent "
        f"({gravity.T_tip[best]:.2f} N), least at {np.degrees(ANGLES[worst]):.0f}° "
        f"({gravity.T_tip[worst]:.2f} N); without gravity {unloaded.T_tip[0]:.2f} N.",
    ]
    return Study(
        title="External loads",
        text=text,
        solved=(facts["points_converged"] + solved_steps, facts["points"] + steps),
        statements=[
            beyond(
                "External loads change tension loss (the subject of reference [8]).",
                f"Tip force: up to {largest:.2f} N of T_tip per newton near zero; weight: "
                f"{spread['T_tip']:.2f} N between the best and the worst direction; 100 g at the tip: "
                + ", ".join(
                    f"{p['dT_tip_per_100_g_N']:+.2f} N ({name})" for name, p in facts["payload"].items()
                )
                + ".",
                largest > 0.1 or spread["T_tip"] > 0.1,
            )
        ],
        figures=[
            Figure(
                "loads-force",
                draw.plot_forces(FORCES, points),
                f"TD-CM I at {T_MAX:g} N under a dead force on its tip, put on before the pull.",
            ),
            Figure(
                "loads-gravity",
                draw.plot_gravity(ANGLES, gravity, unloaded),
                f"TD-CM I at {T_MAX:g} N with its weight, turned through a circle. 0°: hanging; 90°: the "
                "weight helps the tendon; 180°: upright; 270°: the tendon lifts. Dashed: no gravity.",
            ),
            Figure(
                "loads-loops",
                draw.plot_loaded_loops(runs),
                "Loops of TD-CM I under loads that stand from the start.",
            ),
        ],
        tables=[_force_table(forces), _payload_table(payload)],
        facts=facts,
    )
