"""The experiment that would tell rivals apart."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from gtr_jax.sensing import cells_show

from ..base_tension import exact
from ..coordinates import CHANNELS
from .bench import Fitted
from .decide import Decision
from .rig import Rig
from .search import Models, in_parallel

# Noise assumed of instruments that were not used: m, m, rad, m.
POSE_NOISE = {"tip_x": 3e-4, "tip_y": 3e-4, "tip_angle": 5e-3, "displacement": 1e-4}
MOST_RIVALS = 3
STEP = 0.05
# Standard errors beyond which more is no better.
ENOUGH = 6.0
WEIGHTS = "hang known weights on each cell in turn, up and down"


@dataclasses.dataclass(frozen=True, eq=False)
class Experiment:
    """What to measure next.

    Attributes:
        says: in a sentence.
        separates: the models it tells apart, by names of hypotheses.
        expected_probability: that the true one of them then has, in the mean.
        time: of the load history [s], (K,).
        T_base: base tension to drive [N], (K,); of weights, that on the base's cell.
        T_tip: of weights, that on the tip's cell [N], (K,); else None.
        record: channels to record.
        menu: all that was considered, with the separation each reaches [standard errors].
    """

    says: str
    separates: list[tuple[str, ...]]
    expected_probability: float
    time: np.ndarray
    T_base: np.ndarray
    T_tip: np.ndarray | None
    record: tuple[str, ...]
    menu: list[tuple[str, float]]


def menu(largest: float, samples: int, duration: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Load histories that a rig could follow: time [s] and base tension [N], by what they are.

    Args:
        largest: base tension not to exceed [N].
        samples: of each.
        duration: of a loop that is neither slow nor fast [s].
    """

    def through(corners, times):
        t = np.linspace(0.0, times[-1], samples)
        return t, np.interp(t, times, corners)

    a, d = largest, duration
    rest = 0.02 * a
    return {
        "one slow loop to the largest tension": through([rest, a, rest], [0, 2 * d, 4 * d]),
        "the same loop at four rates, each four times the one before": through(
            [rest, a, rest, a, rest, a, rest, a, rest],
            np.cumsum([0, 2 * d, 2 * d, d / 2, d / 2, d / 8, d / 8, d / 32, d / 32]),
        ),
        "inner loops of falling size, at one rate": through(
            [rest, a, 0.3 * a, 0.8 * a, 0.4 * a, 0.7 * a, 0.5 * a, 0.62 * a, 0.56 * a, rest],
            d * np.cumsum([0, 1, 0.7, 0.5, 0.4, 0.3, 0.2, 0.12, 0.06, 0.56]),
        ),
        "loops at low tension": through(
            [rest, 0.15 * a, rest, 0.3 * a, rest, 0.5 * a, rest],
            d * np.cumsum([0, 0.15, 0.15, 0.3, 0.3, 0.5, 0.5]),
        ),
        "steps with long holds, up and down": through(
            [rest, *np.repeat([0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25], 2) * a, rest],
            np.cumsum([0, *([0.1 * d, 1.5 * d] * 7), 0.1 * d]),
        ),
        "many equal loops": through([rest, *([a, rest] * 8)], np.cumsum([0, *([0.5 * d] * 16)])),
    }


def weights(largest: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Known weights hung on one cell and then on the other, up and down again: time [s], and true tension of
    the base's cell and of the tip's [N], (K,) each.
    """
    up_and_down = largest * np.asarray([0, 0.25, 0.5, 0.75, 1, 0.75, 0.5, 0.25, 0])
    none = np.zeros(len(up_and_down))
    base, tip = np.concatenate([up_and_down, none]), np.concatenate([none, up_and_down])
    return 10.0 * np.arange(len(base)), base, tip


class _Option(NamedTuple):
    """Something to measure: what it is, its load history, channels, whether it needs more than the recording
    had, and what it would show under some values, in standard deviations of the noise.
    """

    name: str
    time: np.ndarray
    T_base: np.ndarray
    T_tip: np.ndarray | None
    record: tuple[str, ...]
    more: bool
    shows: Callable[[Mapping[str, float]], np.ndarray | None]


def _options(models: Models, rig: Rig) -> list[_Option]:
    part, noise = rig.part, models.bench.noise[0]
    T, clock = part.T_base.T_base, part.time
    # As many samples as the bench simulates: no other program is compiled.
    duration = 20.0 if clock is None else max(float(clock[-1] - clock[0]) / 6, 1.0)
    sd = {"T_tip": noise[0].sd}
    sd |= {n: POSE_NOISE[n] for n in CHANNELS[1:]} if not rig.robot.backbone.rigid else {}
    sd |= dict(zip(part.channels, [n.sd for n in noise], strict=True))
    every = tuple(n for n in CHANNELS if n in sd)
    found = []
    for name, (time, load) in menu(float(T.max()), part.samples, duration).items():
        other = Rig(
            dataclasses.replace(part, T_base=exact(load), time=time, trial=None), rig.robot, memory=rig.memory
        )
        # Simulated once, whatever of it is recorded.
        seen = functools.cache(lambda values, other=other: other(dict(values)))
        for channels in dict.fromkeys((tuple(part.channels), every)):

            def shows(values, seen=seen, channels=channels):
                shown = seen(tuple(values.items()))
                if shown is None:
                    return None
                return np.concatenate([shown.values[CHANNELS.index(c)] / sd[c] for c in channels])

            found.append(_Option(name, time, load, None, channels, channels != tuple(part.channels), shows))
    time, base, tip = weights(float(T.max()))
    sd_base = max(part.T_base.sd, 1e-6) if part.T_base.sd > 0 else sd["T_tip"]

    def cells(values):
        robot = rig.robot.with_values(**values)
        shown = cells_show(robot, jnp.asarray(base), jnp.asarray(tip), jnp.asarray(time))
        return np.concatenate([np.asarray(shown.T_base) / sd_base, np.asarray(shown.T_tip) / sd["T_tip"]])

    found.append(_Option(WEIGHTS, time, base, tip, ("T_base", "T_tip"), True, cells))
    return found


def _separation(option: _Option, rivals: Sequence[Fitted]) -> float:
    """Least distance [standard errors] between any two rivals once the one refitted follows the other, given
    what it already knows.
    """
    shown = []
    for f in rivals:
        start = option.shows(f.values)
        if start is None:
            return np.inf
        columns = []
        for i, n in enumerate(f.numbers):
            there = option.shows(dict(f.values) | {n.name: n.value(f.x[i] + STEP)})
            columns.append(np.zeros_like(start) if there is None else (there - start) / STEP)
        shown.append((start, np.stack(columns, axis=1)))
    least = np.inf
    for a, b in itertools.permutations(range(len(rivals)), 2):
        off, J = shown[a][0] - shown[b][0], shown[b][1]
        follow = np.linalg.solve(J.T @ J + rivals[b].information(), J.T @ off)
        least = min(least, np.sqrt(max(float(off @ off - follow @ (J.T @ off)), 0.0)))
    return float(least)


def propose(models: Models, decision: Decision, rig: Rig) -> Experiment | None:
    """Choose what to measure, and how, that separates the rivals most (T-optimality)."""
    rivals = [models.fits[tuple(sorted(names))] for names in decision.confusion[:MOST_RIVALS]]
    if len(rivals) < 2:
        ranked = [f for f in models.ranked() if f.names != decision.chosen.names]
        rivals = [decision.chosen, *ranked[:1]]
    if len(rivals) < 2:
        return None
    options = _options(models, rig)
    reached = in_parallel(lambda option: _separation(option, rivals), options)
    scored = [(v, o) for v, o in zip(reached, options, strict=True) if np.isfinite(v)]
    if not scored:
        return None
    # Without new instruments if that is enough.
    scored.sort(key=lambda s: (-min(s[0], ENOUGH) + (0.5 if s[1].more else 0.0), -s[0], s[1].name))
    least, best = scored[0]
    expected = 1 / (1 + (len(rivals) - 1) * np.exp(-0.5 * min(least, 20.0) ** 2))
    which = " and ".join(" + ".join(f.names) if f.names else "nothing missing" for f in rivals)
    added = [c.replace("_", " ") for c in best.record if c not in rig.part.channels]
    also = f" and record {', '.join(added)}" if best.more and best.T_tip is None else ""
    told = "would tell" if least > 3 else "is the best of the menu, but hardly tells"
    verb = "Drive" if best.T_tip is None else "Take the tendon off and"
    return Experiment(
        f"{verb} {best.name}{also}: it {told} {which} apart ({least:.1f} standard errors).",
        [f.names for f in rivals],
        float(expected),
        best.time,
        best.T_base,
        best.T_tip,
        best.record,
        [(f"{o.name}{' with pose' if o.more and o.T_tip is None else ''}", v) for v, o in scored],
    )
