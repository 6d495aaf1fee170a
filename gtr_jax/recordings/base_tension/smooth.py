"""Smooth curves in place of many short runs, where a base tension keeps bending in one direction."""

from __future__ import annotations

import itertools

import numpy as np

from .base_tension import BaseTension, runs

# Number of knots below which nothing is smoothed; ratio of a bend to its neighbours' from which it is a
# corner; drop of the sum of squares that a smooth knot must bring, in variances; and samples per smooth knot.
FEWEST_SMOOTH, SUDDEN, WORTH, ROOM = 8, 4.0, 6.0, 2
# Shares of the knots with which a smooth stretch is tried.
DENSITIES = (1.0, 0.8, 0.65, 0.5, 0.4, 0.3, 0.2)


def smoothed(fit: BaseTension, T: np.ndarray) -> BaseTension:
    """The fit with fewer, smooth knots where the base tension keeps bending in one direction, as a sinusoid
    does; the fit unchanged where that is no better for the number of knots.
    """
    if len(fit.knots) < FEWEST_SMOOTH:
        return fit
    slopes = np.diff(fit.T_base[fit.knots]) / np.diff(fit.t[fit.knots])
    bend = np.concatenate([[0.0], np.diff(slopes), [0.0]])
    beside = np.stack([np.roll(bend, 1), np.roll(bend, -1)])
    like = (beside * bend > 0) & (np.abs(bend) < SUDDEN * np.abs(beside))
    corner = np.logical_not(like.any(axis=0))
    corner[[0, -1]] = True
    best, least = fit, fit.misfit + WORTH * fit.size
    for share in DENSITIES:
        found = runs(fit.t, T, *_resampled(fit.knots, corner, share), fit.sd)
        if found.misfit + WORTH * found.size < least:
            best, least = found, found.misfit + WORTH * found.size
    return best


def _resampled(knots: np.ndarray, corner: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Keep a share of the knots between every two corners, evenly spaced; return them, and which of them are
    corners. A stretch with too few samples stays as it is, straight.
    """
    stops = np.flatnonzero(corner)
    chosen, corners = [knots[stops]], [knots[stops]]
    for a, b in itertools.pairwise(stops.tolist()):
        count = max(1, round(share * (b - a)))
        if b - a > 1 and knots[b] - knots[a] >= ROOM * (count + 2):
            chosen.append(np.round(np.linspace(knots[a], knots[b], count + 1)).astype(int))
        else:
            corners.append(knots[a : b + 1])
    found = np.unique(np.concatenate([*chosen, *corners]))
    return found, np.isin(found, np.concatenate(corners))
