"""Refits to part of a recording, judged on the rest: whole cycles, or whole regimes of a single one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibrate.diagnosis.hypotheses.hypotheses import EVENTS, Hypothesis
from calibrate.diagnosis.hypotheses.model import Fitted
from calibrate.inference.number import OWN
from calibrate.inference.side_by_side import in_lanes

from .likelihood import Likelihood, without_zero
from .locate import cycles_in

# Parts held out in turn, at most; and pieces of a recording that each of them takes where they alternate.
FOLDS, PIECES = 4, 8


def folds(likelihood: Likelihood, *, pieces: bool = False) -> list[tuple[str, list[np.ndarray]]]:
    """What is held out in turn: a name, and which samples of each recording, (K,) bool each.

    In pieces every fourth of about 32 short pieces of each recording, else whole recordings where there are
    three or more that have no number of their own, cycles where a recording has three or more, else stretches
    of the load history: low and high pull, early and late release.
    """
    rigs = likelihood.rigs
    if pieces:
        each = [max(1, round(r.part.samples / (PIECES * FOLDS))) for r in rigs]
        turns = [np.arange(r.part.samples) // n % FOLDS for r, n in zip(rigs, each, strict=True)]
        return [(f"piece {f + 1} of every {FOLDS}", [t == f for t in turns]) for f in range(FOLDS)]
    if len(rigs) >= 3 and not any(OWN in n.name for n in likelihood.base):
        return [(rig.part.name, [np.full(r.part.samples, r is rig) for r in rigs]) for rig in rigs[:FOLDS]]
    cycles = [cycles_in(rig.part) for rig in rigs]
    most = max(int(c[-1]) for c in cycles)
    if most >= 3:
        groups = np.array_split(np.arange(1, most + 1), min(FOLDS, most))
        names = [f"cycle {g[0]}" if len(g) == 1 else f"cycles {g[0]} to {g[-1]}" for g in groups]
        return [(n, [np.isin(c, g) for c in cycles]) for n, g in zip(names, groups, strict=True)]
    shares = [np.floor(FOLDS * np.arange(r.part.samples) / r.part.samples).astype(int) for r in rigs]
    return [(f"stretch {f + 1} of {FOLDS}", [s == f for s in shares]) for f in range(FOLDS)]


def _when_known(hypotheses: Sequence[Hypothesis], fitted: Fitted) -> tuple[list[Hypothesis], np.ndarray]:
    """The hypotheses with the times of events fixed where the whole recording puts them, and where to start:
    nothing in other cycles tells when an event happens, as a note in the lab book would.
    """
    fixed = {n.name for h in hypotheses if h.kind in EVENTS or h.dated for n in h.numbers[1:]}
    own = [
        dataclasses.replace(
            h,
            numbers=tuple(n for n in h.numbers if n.name not in fixed),
            fixed={**h.fixed, **{n.name: fitted.values[n.name] for n in h.numbers if n.name in fixed}},
        )
        for h in hypotheses
    ]
    kept = [n.name not in fixed for n in fitted.numbers]
    return own, fitted.x[np.asarray(kept)]


def by_fold(
    likelihood: Likelihood, models: Sequence[tuple[Sequence[Hypothesis], Fitted]], *, pieces: bool = False
) -> np.ndarray:
    """What each model leaves of each part when it is refitted to the others, (models, folds, 4): sum of
    squares (SI) and number of the samples of what is explained, sum of squares and number of all whitened
    rows; zeros where the refit fails.

    Args:
        likelihood: the recordings.
        models: hypotheses, and their fit to everything, which says what is fitted beside them.
        pieces: as of `folds`.
    """
    parts = [
        (name, held)
        for name, held in folds(likelihood, pieces=pieces)
        if any(np.any(out & rig.part.counted) for out, rig in zip(held, likelihood.rigs, strict=True))
    ]
    jobs = [(m, f) for m in range(len(models)) for f in range(len(parts))]
    known = [_when_known(hypotheses, fitted) for hypotheses, fitted in models]
    benches = [
        likelihood.with_base(fitted.numbers[: len(fitted.numbers) - sum(len(h.numbers) for h in hypotheses)])
        for hypotheses, fitted in models
    ]

    def one(job):
        m, f = job
        hypotheses, start = known[m]
        again = benches[m].without(parts[f][1]).refit(hypotheses, start, most=4, exact=False)
        squares, n, chi, rows = 0.0, 0, 0.0, 0
        if again is None:
            return squares, n, chi, rows
        residuals = likelihood.residuals(again.seen)
        white = likelihood.by_channel(likelihood.robustify(likelihood.white(residuals)))
        for z, residual, held, rig in zip(white, residuals, parts[f][1], likelihood.rigs, strict=True):
            out = held & rig.part.counted
            off = without_zero(rig.part, residual, rig.part.counted & ~held)
            told = off[: rig.part.explained, out]
            squares, n = squares + float(np.sum(told**2)), n + told.size
            chi, rows = chi + float(np.sum(z[:, out] ** 2)), rows + z[:, out].size
        return squares, n, chi, rows

    return np.asarray(in_lanes(one, jobs)).reshape(len(models), len(parts), 4)


def held_out(
    likelihood: Likelihood, models: Sequence[tuple[Sequence[Hypothesis], Fitted]], *, pieces: bool = False
) -> list[dict[str, float]]:
    """Score of each model on samples to which it was not fitted; arguments as of `by_fold`.

    Returns:
        For each model: "rms" of what is explained, SI, and "chi2_per_n" of all channels, over all folds;
        "folds", how many there are; and "best_in", the number of folds in which the rms of this model was
        the lowest. A fold in which a refit fails does not count; NaN where none is left.
    """
    found = by_fold(likelihood, models, pieces=pieces)
    # Parts in which every model was refitted: all are judged on the same samples.
    found[:, np.any(found[..., 1] == 0, axis=0)] = 0.0
    counted = found[..., 1]
    rms = np.sqrt(np.where(counted > 0, found[..., 0], np.inf) / np.maximum(counted, 1))
    best = np.argmin(rms, axis=0)
    return [
        {
            "rms": float(np.sqrt(np.sum(f[:, 0]) / np.sum(f[:, 1]))) if np.any(f[:, 1]) else float("nan"),
            "chi2_per_n": float(np.sum(f[:, 2]) / np.sum(f[:, 3])) if np.any(f[:, 3]) else float("nan"),
            "folds": found.shape[1],
            "best_in": int(np.sum((best == m) & np.isfinite(rms[m]))),
        }
        for m, f in enumerate(found)
    ]
