"""Phases by a rule without a model: the tendon slips where the tip follows the base in the ratio of the two
tensions; where it does not, friction holds it.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

PULLING, RELEASING, TRANSITION, HOLD, SLACK = range(1, 6)
NAMES = {
    PULLING: "pulling",
    RELEASING: "releasing",
    TRANSITION: "transition",
    HOLD: "hold",
    SLACK: "slack",
}
SLIPS = 0.5
"""On Coulomb's law dT_tip/dT_base equals T_tip/T_base while the tendon slips, and is 0 while friction holds
the tip: above this share of that ratio it slips."""
# The two tensions are compared over steps of the base tension of this share of its range, or of so many
# standard deviations of the noise of either cell.
STEP, OF_NOISE = 0.015, 10.0
# Below this share of the range of the base tension the ratio means nothing.
NEAR_ZERO = 0.03


@dataclasses.dataclass(frozen=True, eq=False)
class Phases:
    """Phase of each sample.

    Attributes:
        label: PULLING, RELEASING, TRANSITION, HOLD or SLACK, (K,).
        step_N: change of the base tension over which the tip was asked to follow.
        steps: first and last sample of each step, (S, 2), and `of_step` their phases, (S,).
    """

    label: np.ndarray
    step_N: float
    steps: np.ndarray
    of_step: np.ndarray

    def share(self, phase: int) -> float:
        """Share of the samples in a phase."""
        return float(np.mean(self.label == phase))

    def runs_of(self, phase: int) -> list[tuple[int, int]]:
        """First and last sample of each uninterrupted run of steps in a phase, without the step that follows
        on friction that held, in which slip only begins.
        """
        found: list[tuple[int, int]] = []
        for own, group in itertools.groupby(range(len(self.of_step)), key=lambda i: self.of_step[i]):
            places = list(group)
            held = places[0] == 0 or self.of_step[places[0] - 1] in (TRANSITION, SLACK)
            places = places[1:] if held else places
            if own == phase and places:
                found.append((int(self.steps[places[0], 0]), int(self.steps[places[-1], 1])))
        return found


def phases(
    T_base: np.ndarray,
    T_tip: np.ndarray,
    *,
    turns: np.ndarray,
    noise: tuple[float, float],
    quiet: list[tuple[int, int]],
) -> Phases:
    """The phase of each sample.

    Args:
        T_base, T_tip: tensions without the zeros of the cells [N], (K,).
        turns: turning points of the base tension, and both ends, increasing.
        noise: standard deviations of both cells [N].
        quiet: first and last sample of each stretch in which the base stands still.
    """
    reach = float(np.ptp(T_base))
    share = float(np.ptp(T_tip)) / reach if reach > 0 else 0.0
    of_tip = OF_NOISE * noise[1] / share if share > 0 else 0.0
    step = max(STEP * reach, OF_NOISE * noise[0], min(of_tip, 0.1 * reach))
    nodes = _nodes(T_base, turns, step)
    first, last = nodes[:-1], nodes[1:]
    base, tip = T_base[last] - T_base[first], T_tip[last] - T_tip[first]
    middle_base, middle_tip = (0.5 * (T[first] + T[last]) for T in (T_base, T_tip))
    with np.errstate(divide="ignore", invalid="ignore"):
        follows = (tip / base) / (middle_tip / middle_base)
    of_step = np.where(base > 0, PULLING, RELEASING)
    of_step[follows < SLIPS] = TRANSITION
    near = np.minimum(T_base[first], T_base[last]) - min(float(np.min(T_base)), 0.0) < NEAR_ZERO * reach
    of_step[near | ~np.isfinite(follows)] = SLACK
    label = np.empty(len(T_base), np.int8)
    label[:] = SLACK
    lengths = np.diff(nodes)
    label[nodes[0] : nodes[-1]] = np.repeat(of_step, lengths)
    label[nodes[-1] :] = of_step[-1] if len(of_step) else SLACK
    for a, b in quiet:
        loaded = label[a : b + 1] != SLACK
        label[a : b + 1][loaded] = HOLD
    return Phases(label, step, np.stack([first, last], axis=1), of_step)


def _nodes(T: np.ndarray, turns: np.ndarray, step: float) -> np.ndarray:
    """Turning points, and between them the samples at which a tension has changed by another `step`."""
    found = [turns]
    for a, b in itertools.pairwise(turns.tolist()):
        way = T[a : b + 1] - T[a]
        way = np.maximum.accumulate(way if way[-1] > 0 else -way)
        count = int(way[-1] / step) if step > 0 else 0
        if count > 1:
            levels = np.arange(1, count) * (way[-1] / count)
            found.append(a + np.searchsorted(way, levels))
    return np.unique(np.concatenate(found))
