"""Pairs of effects that promise together what neither does alone.

A search that adds effects one at a time starts from the best single effects, refitted. Where two effects
hide each other, or the base model hides both, each alone gains little and is refitted to the wrong place. All
pairs are therefore looked at from the base model, to first order, with what the screen has simulated anyway.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calibrate.diagnosis.hypotheses.hypotheses import Hypothesis, may_join
from calibrate.diagnosis.hypotheses.model import Fitted

from .screen import FAR, Screened, Try

# By how much the size of a start may be changed; and times that the two sizes of a pair follow each other.
LEAST, MOST, ROUNDS = 0.2, 2.0, 6
# A pair must promise this much more than the better of its effects, in variances.
SURPLUS = 12.0


class Pair(NamedTuple):
    """Two hypotheses, the drop of the sum of squares that they promise together, and where to refit from."""

    hypotheses: tuple[Hypothesis, Hypothesis]
    gain: float
    start: np.ndarray


def promising(base: Fitted, screened: Sequence[Screened], most: int) -> list[Pair]:
    """The most promising pairs, the best first.

    The residual and the changes that hypotheses make are projected on what the fitted numbers cannot follow.
    There the drop of the sum of squares is 2 b's - s'Gs for sizes s of the two changes, with the Gram matrix
    G and b of the changes and the residual, less the priors of the coordinates.

    Args:
        base: the base model.
        screened: hypotheses tried beside it.
        most: how many pairs are wanted.
    """
    J = np.concatenate([base.jacobian, np.eye(len(base.x))])
    q, upper = np.linalg.qr(J)
    r0 = np.concatenate([base.rows, base.x])
    tries = [(s.hypothesis, t) for s in screened for t in s.tries]
    if not tries:
        return []
    across = np.stack([t.moved for _, t in tries])
    across -= (across @ q) @ q.T
    gram, toward = across @ across.T, -across @ (r0 - q @ (q.T @ r0))
    weight = np.asarray([float(t.x @ t.x) for _, t in tries])
    free = np.asarray([t.scales for _, t in tries])
    power = np.diag(gram) + np.where(free, weight, 0.0)
    alone = _sizes(toward / np.maximum(power, 1e-12), free)
    single = 2 * alone * toward - alone**2 * np.diag(gram) - alone**2 * weight
    # All pairs of tries at once: a is the size of the first of each, b that of the second.
    a, b = np.broadcast_to(alone[:, None], gram.shape), np.broadcast_to(alone[None], gram.shape)
    for _ in range(ROUNDS):
        a = _sizes((toward[:, None] - gram * b) / np.maximum(power[:, None], 1e-12), free[:, None])
        b = _sizes((toward[None] - gram * a) / np.maximum(power[None], 1e-12), free[None])
    ones = np.diag(gram) + weight
    gain = 2 * (a * toward[:, None] + b * toward[None]) - a**2 * ones[:, None] - b**2 * ones[None]
    gain -= 2 * a * b * gram
    surplus = gain - np.maximum(single[:, None], single[None])
    best: dict[tuple[str, str], Pair] = {}
    kinds = [h.kind for h, _ in tries]
    order = np.dstack(np.unravel_index(np.argsort(-gain, axis=None), gain.shape))[0]
    for i, j in order:
        if len(best) == most or gain[i, j] <= SURPLUS:
            break
        one, other = tries[i][0], tries[j][0]
        key = (one.name, other.name)
        if i >= j or kinds[i] == kinds[j] or key in best or surplus[i, j] < SURPLUS:
            continue
        if not may_join(one, [other]):
            continue
        moved = a[i, j] * tries[i][1].moved + b[i, j] * tries[j][1].moved
        follow = np.clip(np.linalg.solve(upper, -(q.T @ (r0 + moved))), -FAR, FAR)
        own = [_scaled(h, t, float(s)) for (h, t), s in ((tries[i], a[i, j]), (tries[j], b[i, j]))]
        best[key] = Pair((one, other), float(gain[i, j]), np.concatenate([base.x + follow, *own]))
    return list(best.values())


def _sizes(wanted: np.ndarray, free: np.ndarray) -> np.ndarray:
    return np.where(free, np.clip(wanted, LEAST, MOST), 1.0)


def _scaled(h: Hypothesis, t: Try, size: float) -> np.ndarray:
    """Coordinates of a try with its sizes scaled."""
    sizes = np.asarray([n.size and not n.log for n in h.numbers])
    return np.where(sizes, size * t.x, t.x)
