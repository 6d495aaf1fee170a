"""Histories that are not one pull and one release: the tendon's memory, on TD-CM I.

The paper leaves them to future work. The friction law needs nothing more for them: a stretch of tendon keeps
its tension until the band that friction can hold against the base reaches it (DESIGN, section 2).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gtr_jax.mechanics.channel import metric_factor
from gtr_jax.mechanics.mesh import increments
from gtr_jax.report.page import Figure, Table
from gtr_jax.robot.robot import Robot, sections
from gtr_jax.simulation.history import Simulation, simulate
from gtr_jax.simulation.phases import PULLING, RELEASING, label_phases
from gtr_jax.simulation.slipping import SLIP_TOLERANCE

from . import memory_figures as draw
from .manipulators import case_of, family, robot_of, solved_robot, template
from .study import Statement, Study, beyond

STEP = 0.25  # N
LONGEST = 2048  # steps: all histories run padded to one length, in one compiled program
HISTORIES: dict[str, Sequence[float]] = {
    "re-pull from the transition": (0, 45, 25, 45, 0),
    "inner loops": (0, 45, 20, 35, 20, 45, 6, 30, 6, 45, 0),
    "creeping staircase": (0, *(t for k in range(1, 8) for t in (5 * k + 5, 5 * k)), 45),
    "decaying cycles": (0, 45, 2, 40, 5, 35, 9, 30, 13, 26, 16, 23, 18, 21, 20),
}
CONGRUENT = (20.0, 30.0)
MOVING = (4.0, 40.0)
SAME = 1e-6  # N or mm: below, two states are one; the solver leaves up to 1e-9


class Ledger(NamedTuple):
    """Work since the first step, at every step, (K,) [J].

    put_in: at the base, base tension times displacement. stored: in the bent body. friction: drop of the
    tension along the tendon times the slip there, which uses neither the base tension nor the stiffness.
    creep: slip [m], summed over steps, of the node that slips most while its tension is locked.
    """

    put_in: np.ndarray
    stored: np.ndarray
    friction: np.ndarray
    creep: np.ndarray


class Story(NamedTuple):
    """A history, run: turning tensions [N], the steps at which they stand, simulation, phases, work."""

    turns: tuple[float, ...]
    at: np.ndarray
    run: Simulation
    phases: np.ndarray
    ledger: Ledger

    def stretch(self, first: int, last: int) -> slice:
        """Steps from one turning point to another, both included."""
        return slice(int(self.at[first]), int(self.at[last]) + 1)

    def work(self, first: int, last: int) -> dict[str, float]:
        """Work from one turning point to another [J]."""
        start, end = int(self.at[first]), int(self.at[last])
        return {
            f"{name}_J": float(values[end] - values[start])
            for name, values in self.ledger._asdict().items()
            if name != "creep"
        }


def ramps(turns: Sequence[float], step: float = STEP) -> tuple[np.ndarray, np.ndarray]:
    """Base tensions [N] from turn to turn in equal steps of at most `step`, and the step of each turn."""
    pieces, at = [np.asarray(turns[:1], float)], [0]
    for start, end in itertools.pairwise(turns):
        count = max(int(np.ceil(abs(end - start) / step - 1e-9)), 1)
        pieces.append(np.linspace(start, end, count + 1)[1:])
        at.append(at[-1] + count)
    return np.concatenate(pieces), np.asarray(at)


def tell(robot: Robot, turns: Sequence[float], step: float = STEP) -> Story:
    """Run a history given by its turning tensions [N]."""
    T_base, at = ramps(turns, step)
    padded = np.concatenate([T_base, np.full(LONGEST - len(T_base), T_base[-1])])
    whole = simulate(robot, jnp.asarray(padded))
    ledger = Ledger(*(np.asarray(column)[: len(T_base)] for column in _ledger(robot, whole)))

    def cut(column):
        return jnp.asarray(np.asarray(column)[: len(T_base)])  # on the host: a slice there compiles nothing

    run = Simulation(**{k: v if k == "s" else jax.tree_util.tree_map(cut, v) for k, v in vars(whole).items()})
    return Story(tuple(float(t) for t in turns), at, run, label_phases(run), ledger)


@eqx.filter_jit
def _ledger(robot: Robot, run: Simulation) -> tuple:
    """The fields of `Ledger`, by the trapezoidal rule between steps."""
    at = sections(robot)
    weights, T = at.mesh.weights, run.tension
    stretch = jax.vmap(lambda kappa: increments(weights, metric_factor(kappa, at.R)))(run.curvature)
    # Slip towards the base: what lies beyond the node has shortened.
    slip = stretch - jnp.cumsum(stretch[:, ::-1], axis=1)[:, ::-1]
    moved, middle = jnp.diff(slip, axis=0), 0.5 * (T[1:] + T[:-1])
    drop = middle[:, :-1] - middle[:, 1:]
    friction = jnp.sum(drop * 0.5 * (moved[:, :-1] + moved[:, 1:]), axis=1)

    def stored(kappa):
        return jnp.sum(increments(weights, (kappa - at.rest) ** 2 / (2 * at.compliance)))

    energy = jax.vmap(stored)(run.curvature)
    put_in = 0.5 * (run.T_base[1:] + run.T_base[:-1]) * jnp.diff(run.displacement)
    locked = jnp.abs(jnp.diff(T, axis=0)) <= SLIP_TOLERANCE * jnp.max(run.T_base)
    creep = jnp.max(jnp.cumsum(jnp.where(locked, jnp.abs(moved), 0.0), axis=0), axis=1)

    def summed(rows):
        return jnp.concatenate([jnp.zeros(1), jnp.cumsum(rows)])

    return summed(put_in), energy - energy[0], summed(friction), jnp.concatenate([jnp.zeros(1), creep])


def _largest_difference(run: Simulation, first: int, second: int) -> float:
    """Largest difference of the tension anywhere along the tendon between two steps [N]."""
    return float(jnp.max(jnp.abs(run.tension[first] - run.tension[second])))


def memory_facts(robot: Robot, stories: dict[str, Story]) -> dict[str, Any]:
    """What of hysteresis holds, in numbers (see `study_histories`)."""
    repull, inner = stories["re-pull from the transition"], stories["inner loops"]
    decaying, stairs = stories["decaying cycles"], stories["creeping staircase"]
    a = inner.at
    # The outer loop again after inner loops: 45 -> 0 with and without them.
    plain = tell(robot, (0, 45, 0))
    after = inner.run.tension[inner.stretch(9, 10)]
    same = plain.run.tension[plain.stretch(1, 2)]
    facts = {
        "inner_loop_20_35_20_tension_N": _largest_difference(inner.run, a[2], a[4]),
        "inner_loop_6_30_6_tension_N": _largest_difference(inner.run, a[6], a[8]),
        "outer_maximum_after_20_N_tension_N": _largest_difference(inner.run, a[1], a[5]),
        "outer_maximum_after_6_N_tension_N": _largest_difference(inner.run, a[1], a[9]),
        "repull_tension_N": _largest_difference(repull.run, repull.at[1], repull.at[3]),
        "repull_T_tip_N": float(repull.run.T_tip[repull.at[3]] - repull.run.T_tip[repull.at[1]]),
        "wiped_out_tension_N": float(jnp.max(jnp.abs(after - same))),
        "staircase_T_tip_against_one_pull_N": float(stairs.run.T_tip[-1] - plain.run.T_tip[plain.at[1]]),
        "staircase_tension_against_one_pull_N": float(
            jnp.max(jnp.abs(stairs.run.tension[-1] - plain.run.tension[plain.at[1]]))
        ),
        "decaying_final_T_base_N": float(decaying.run.T_base[-1]),
        "decaying_final_T_tip_N": float(decaying.run.T_tip[-1]),
        "pulled_once_to_final_T_tip_N": float(tell(robot, (0, decaying.turns[-1])).run.T_tip[-1]),
        "creep_of_locked_stretches_mm": 1e3 * float(inner.ledger.creep[-1]),
        "largest_displacement_mm": 1e3 * float(jnp.max(inner.run.displacement)),
    }
    return facts | {"congruency": _congruency(robot), "work": _work_facts(robot, plain)}


def _congruency(robot: Robot) -> dict[str, Any]:
    """Inner loops between the same limits after different histories: how far their shapes differ."""
    found: dict[str, Any] = {}
    for name, (low, high) in {"tip locked": CONGRUENT, "tip moving": MOVING}.items():
        first = tell(robot, (0, high, low, high))  # from a first pull
        second = tell(robot, (0, 45, low, high, low, high))  # from a release
        loops = [(first, first.stretch(1, 3)), (second, second.stretch(3, 5))]
        entry: dict[str, Any] = {"low_N": low, "high_N": high}
        for key, values, scale in (
            ("T_tip_N", "T_tip", 1.0),
            ("displacement_mm", "displacement", 1e3),
        ):
            one, two = (scale * np.asarray(getattr(story.run, values)[steps]) for story, steps in loops)
            entry[key] = {
                "range": [float(np.ptp(one)), float(np.ptp(two))],
                "level": [float(one[0]), float(two[0])],
                "shape_difference": float(np.max(np.abs((one - one[0]) - (two - two[0])))),
            }
        entry["work_lost_J"] = [first.work(1, 3)["friction_J"], second.work(3, 5)["friction_J"]]
        found[name] = entry
    return found


def _work_facts(robot: Robot, plain: Story) -> dict[str, Any]:
    """Balance over the outer cycle, at two step sizes, and over inner loops of rising height."""
    coarse = tell(robot, (0, 45, 0), 2 * STEP)
    inner = []
    for low in (40.0, 35.0, 30.0, 25.0, 20.0, 15.0, 10.0, 5.0):
        story = tell(robot, (0, 45, low, 45))
        inner.append({"low_N": low, **story.work(1, 3)})
    return {
        "outer_cycle": plain.work(0, 2),
        "outer_cycle_double_step": coarse.work(0, 2),
        "pull_only": plain.work(0, 1),
        "loops_from_45_N": inner,
    }


def _statements(free: dict[str, Any], weighed: dict[str, Any]) -> list[Statement]:
    both = {"no gravity": free, "pulled up": weighed}

    def each(*keys: str) -> str:
        return ", ".join(f"{max(f[k] for k in keys):.0e} N ({name})" for name, f in both.items())

    def holds(*keys: str) -> bool:
        return all(f[k] < SAME for f in both.values() for k in keys)

    closed = ("inner_loop_20_35_20_tension_N", "inner_loop_6_30_6_tension_N")
    rejoined = ("outer_maximum_after_20_N_tension_N", "outer_maximum_after_6_N_tension_N", "repull_tension_N")
    erased = ("wiped_out_tension_N", "staircase_tension_against_one_pull_N")
    shapes = {name: f["congruency"]["tip locked"]["displacement_mm"] for name, f in both.items()}
    moving = free["congruency"]["tip moving"]
    locked = free["congruency"]["tip locked"]
    outer = {name: f["work"]["outer_cycle"] for name, f in both.items()}
    apart = {name: abs(w["put_in_J"] / w["friction_J"] - 1) for name, w in outer.items()}
    return [
        beyond(
            "An inner loop closes (return-point memory).",
            "20 → 35 → 20 N and 6 → 30 → 6 N: the tension anywhere along the tendon is back within "
            f"{each(*closed)}.",
            holds(*closed),
        ),
        beyond(
            "The outer loop is rejoined where it was left.",
            "Back at 45 N after 20, 25 and 6 N, the tension is that of the first pull within "
            f"{each(*rejoined)}.",
            holds(*rejoined),
        ),
        beyond(
            "A larger swing erases the smaller ones before it (wiping out).",
            "45 → 0 N at once and after three inner loops, 45 N in one pull and by a staircase: the same "
            f"within {each(*erased)}.",
            holds(*erased),
        ),
        beyond(
            "Inner loops between the same base tensions have the same shape (congruency).",
            f"{locked['low_N']:g} to {locked['high_N']:g} N after a first pull and after 45 N, tip locked: "
            "displacement "
            + "; ".join(
                f"{name}, swings {d['range'][0]:.4f} and {d['range'][1]:.4f} mm, shapes differ by up to "
                f"{d['shape_difference']:.0e} mm"
                for name, d in shapes.items()
            )
            + f". {moving['low_N']:g} to {moving['high_N']:g} N, where the whole tendon slips and nothing "
            f"is remembered: {moving['displacement_mm']['shape_difference']:.0e} mm. With a weight, where "
            "the tendon is locked the body still bends when the rest of it moves, so the shape depends on "
            "what is locked there.",
            all(d["shape_difference"] < SAME for d in shapes.values()),
        ),
        beyond(
            "The work lost in a cycle is friction's.",
            "0 → 45 → 0 N: "
            + "; ".join(
                f"{name}, {1e3 * w['put_in_J']:.2f} mJ put in, {1e3 * w['friction_J']:.2f} mJ by friction "
                f"({apart[name]:.0e} apart)"
                for name, w in outer.items()
            )
            + ".",
            all(a < 1e-3 for a in apart.values()),
        ),
    ]


def _work_table(facts: dict[str, Any]) -> Table:
    rows = [
        [
            f"45 → {w['low_N']:g} → 45 N",
            f"{1e3 * w['put_in_J']:.3f}",
            f"{1e3 * w['friction_J']:.3f}",
            f"{1e3 * w['stored_J']:.3f}",
        ]
        for w in facts["work"]["loops_from_45_N"]
    ]
    for name, key in (("0 → 45 → 0 N", "outer_cycle"), ("0 → 45 N", "pull_only")):
        w = facts["work"][key]
        rows.append([name, *(f"{1e3 * w[k]:.3f}" for k in ("put_in_J", "friction_J", "stored_J"))])
    return Table(
        "Work over a loop [mJ]",
        ["base tension", "put in at the base", "friction", "stored in the body"],
        rows,
        "Put in: area of base tension against displacement. Friction: drop of tension times slip, along the "
        "tendon.",
    )


def study_histories(progress: Callable[[str], None]) -> Study:
    """The tendon's memory under histories that are not sequential, on TD-CM I at |r| = 10 mm, no gravity.

    Args:
        progress: told each stage.
    """
    progress("histories: TD-CM I")
    robot = solved_robot("TD-CM I")
    stories = {name: tell(robot, turns) for name, turns in HISTORIES.items()}
    facts = memory_facts(robot, stories)
    progress("histories: TD-CM I with its weight")
    pair = family().pair("TD-CM I", "pulled up")
    heavy = robot_of(template(True), case_of("TD-CM I", gravity="pulled up"), float(pair.mu), float(pair.E))
    loaded_stories = {name: tell(heavy, turns) for name, turns in HISTORIES.items()}
    weighed = memory_facts(heavy, loaded_stories)
    told = [*stories.values(), *loaded_stories.values()]
    converged = sum(int(jnp.sum(story.run.converged)) for story in told)
    steps = sum(len(story.run.T_base) for story in told)
    inner, decaying = stories["inner loops"], stories["decaying cycles"]
    whole = {n: float(np.mean(np.isin(s.phases, (PULLING, RELEASING)))) for n, s in stories.items()}
    text = [
        "Re-pulls, inner loops, a staircase and decaying cycles follow the same law without additions: "
        f"{converged} of {steps} steps converged, with and without gravity. The whole tendon slips in "
        + ", ".join(f"{100 * share:.0f} % ({name})" for name, share in whole.items())
        + " of the steps; in the others a front runs from the base, and beyond it the tension is that of an "
        "earlier load.",
        "Without external load the classical facts hold to the last digit although the body deforms: at "
        "every section the curvature is fixed by the tension there, so what is locked keeps its shape, and "
        "what happens between base and front does not know of what lies beyond. With the body's weight the "
        "whole shape is coupled: return points still hold, congruency holds only nearly, and where the "
        "tension is locked the tendon creeps in its channel, up to "
        f"{weighed['creep_of_locked_stretches_mm']:.2f} mm in all through the inner loops "
        f"({_mesh_creep(facts)} of it is the mesh's), of {weighed['largest_displacement_mm']:.1f} mm drawn "
        "out. A law that follows the slip itself would let the tension there change; this one, like the "
        "paper's, does not.",
        f"Memory at the tip is worth newtons: at {facts['decaying_final_T_base_N']:g} N at the base there "
        f"are {facts['pulled_once_to_final_T_tip_N']:.1f} N at the tip after one pull and "
        f"{facts['decaying_final_T_tip_N']:.1f} N after decaying cycles.",
    ]
    figures = [
        Figure(
            "memory-loops",
            draw.plot_loops({n: (s.run, s.phases) for n, s in stories.items()}),
            "Tip against base tension of TD-CM I, by phase. Transition: part of the tendon is locked.",
        ),
        *(
            Figure(
                f"memory-map-{key}",
                draw.plot_map(story.run),
                f"{name.capitalize()}: tensions at base and tip, and what each part of the tendon does. "
                "Fronts start at the base and run until the next turn.",
            )
            for key, name, story in (
                ("inner", "inner loops", inner),
                ("decaying", "decaying cycles", decaying),
            )
        ),
        Figure(
            "memory-tension",
            draw.plot_tensions(decaying.run, decaying.at[1:]),
            "Tension along the tendon at the turns of the decaying cycles, as far as it has just slipped. "
            "Dotted: what is locked at the end; it keeps a kink for every swing that has not been wiped out.",
        ),
    ]
    return Study(
        title="Histories that are not sequential",
        text=text,
        solved=(converged, steps),
        statements=_statements(facts, weighed),
        figures=figures,
        tables=[_work_table(facts)],
        facts={
            "no_gravity": facts,
            "pulled_up": weighed,
            "steps": steps,
            "steps_converged": converged,
            "turning_tensions_N": {n: list(s.turns) for n, s in stories.items()},
        },
    )


def _mesh_creep(facts: dict[str, Any]) -> str:
    """What the ledger calls creep where, without external load, there is none: the mesh's error."""
    return f"{facts['creep_of_locked_stretches_mm']:.2f} mm"
