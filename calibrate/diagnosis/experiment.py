"""The experiment that would tell rivals apart."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

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


@dataclasses.dataclass(frozen=True, eq=False)
class Experiment:
    """What to measure next.

    Attributes:
        says: in a sentence.
        separates: the models it tells apart, by names of hypotheses.
        expected_probability: that the true one of them then has, in the mean.
        time: of the load history [s], (K,).
        T_base: base tension to drive [N], (K,).
        record: channels to record.
        menu: all that was considered, with the separation each reaches [standard errors].
    """

    says: str
    separates: list[tuple[str, ...]]
    expected_probability: float
    time: np.ndarray
    T_base: np.ndarray
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


def propose(models: Models, decision: Decision, rig: Rig) -> Experiment | None:
    """Choose the load history, and what to record, that separates the rivals most (T-optimality): the least
    distance between any two of them once the one refitted follows the other.
    """
    rivals = [models.fits[tuple(sorted(names))] for names in decision.confusion[:MOST_RIVALS]]
    if len(rivals) < 2:
        ranked = [f for f in models.ranked() if f.names != decision.chosen.names]
        rivals = [decision.chosen, *ranked[:1]]
    if len(rivals) < 2:
        return None
    part = rig.part
    T, clock = part.T_base.T_base, part.time
    # As many samples as the bench simulates: no other program is compiled.
    duration = 20.0 if clock is None else max(float(clock[-1] - clock[0]) / 6, 1.0)
    options = menu(float(T.max()), part.samples, duration)
    noise = models.bench.noise[0]
    sd = {"T_tip": noise[0].sd}
    sd |= {n: POSE_NOISE[n] for n in CHANNELS[1:]} if not rig.robot.backbone.rigid else {}
    sd |= dict(zip(part.channels, [n.sd for n in noise], strict=True))

    def trial(values: Mapping[str, float], history) -> np.ndarray | None:
        time, load = history
        other = dataclasses.replace(part, T_base=exact(load), time=time, trial=None)
        seen = Rig(other, rig.robot, memory=rig.memory)(values)
        return None if seen is None else seen.values

    def slopes(f: Fitted, history):
        start = trial(f.values, history)
        if start is None:
            return None
        columns = []
        for i, n in enumerate(f.numbers):
            x = f.x[i] + STEP
            there = trial(dict(f.values) | {n.name: n.value(x)}, history)
            columns.append(np.zeros_like(start) if there is None else (there - start) / STEP)
        return start, np.stack(columns, axis=-1)

    jobs = [(name, k) for name in options for k in range(len(rivals))]
    found = in_parallel(lambda job: slopes(rivals[job[1]], options[job[0]]), jobs)
    by = dict(zip(jobs, found, strict=True))
    scored = []
    chosen_channels = [tuple(part.channels)]
    more = tuple(n for n in CHANNELS if n in sd)
    if more != chosen_channels[0]:
        chosen_channels.append(more)
    for name, history in options.items():
        for channels in chosen_channels:
            rows = [CHANNELS.index(c) for c in channels]
            weight = 1 / np.asarray([sd[c] for c in channels])[:, None]
            least = np.inf
            for a in range(len(rivals)):
                for b in range(len(rivals)):
                    if a == b or by[name, a] is None or by[name, b] is None:
                        continue
                    off = ((by[name, a][0] - by[name, b][0])[rows] * weight).ravel()
                    J = (by[name, b][1][rows] * weight[..., None]).reshape(off.size, -1)
                    A = J.T @ J + rivals[b].information()
                    # What a refit of the rival makes up for, given what it already knows.
                    follow = np.linalg.solve(A, J.T @ off)
                    rest = float(off @ off - follow @ (J.T @ off))
                    least = min(least, np.sqrt(max(rest, 0.0)))
            if np.isfinite(least):
                scored.append((least, len(channels) > len(part.channels), name, history, channels))
    if not scored:
        return None
    # Without new instruments if that is enough.
    scored.sort(key=lambda s: (-min(s[0], 6.0) + (0.5 if s[1] else 0.0), -s[0], s[2]))
    least, extra, name, history, channels = scored[0]
    odds = float(0.5 * min(least, 20.0) ** 2)
    expected = 1 / (1 + (len(rivals) - 1) * np.exp(-odds))
    which = " and ".join(" + ".join(f.names) if f.names else "nothing missing" for f in rivals)
    also = (
        " and record " + ", ".join(c.replace("_", " ") for c in channels if c not in part.channels)
        if extra
        else ""
    )
    told = "would tell" if least > 3 else "is the best of the menu, but hardly tells"
    says = f"Drive {name}{also}: it {told} {which} apart ({least:.1f} standard errors)."
    return Experiment(
        says,
        [f.names for f in rivals],
        float(expected),
        history[0],
        history[1],
        channels,
        [(f"{n}{' with pose' if e else ''}", float(v)) for v, e, n, _, _ in scored],
    )
