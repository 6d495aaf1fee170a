"""What an experiment is worth: how far it holds rivals apart, and how much it narrows intervals."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from .model import OpenModel
from .outcome import Weighed

# Separation [standard errors] above which more brings no advantage.
ENOUGH = 6.0
# What a diagnosis counts against the separation for each thing that an experiment takes beyond another load
# history [standard errors].
EFFORT_OF_NEED = 0.5
# What the effort of an experiment counts against the narrowing of intervals, in logarithms.
EFFORT_IN_LOGS = 0.2


def apart(a: np.ndarray, b: np.ndarray, slopes: np.ndarray, information: np.ndarray) -> float:
    """Distance [standard errors] that is left between two models' readings once the second has followed the
    first, to first order, within what is known of its numbers: the root of
    min over x of |a - b - J x|^2 + x' I x.

    Args:
        a, b: readings in standard deviations of the noise, (n,).
        slopes: J, derivatives of the second by its coordinates, (n, p).
        information: I, about them before the experiment, (p, p).
    """
    off = a - b
    follow = np.linalg.solve(slopes.T @ slopes + information, slopes.T @ off)
    return float(np.sqrt(max(float(off @ off - follow @ (slopes.T @ off)), 0.0)))


def separations(information: Sequence[np.ndarray], shown: Sequence[Weighed]) -> np.ndarray:
    """Distance of each pair of models [standard errors], (m, m), the smaller of both ways.

    Args:
        information: about the coordinates of each of m models before the experiment, (p, p) each.
        shown: readings and derivatives of each.
    """
    found = np.zeros((len(shown), len(shown)))
    for i, j in itertools.combinations(range(len(shown)), 2):
        ways = []
        for a, b in ((shown[i].rows, j), (shown[j].rows, i)):
            rows, slopes, white = shown[b]
            ways.append(apart(white(a), white(rows), white(slopes), information[b]))
        found[i, j] = found[j, i] = min(ways)
    return found


def pairs(separation: np.ndarray) -> np.ndarray:
    """The distances of all pairs, each once."""
    return separation[np.triu_indices(len(separation), 1)]


def worth_of_separation(separation: np.ndarray, effort: float) -> float:
    """Mean distance of the pairs, of which no more counts than is enough, less the effort."""
    return float(np.mean(np.minimum(pairs(separation), ENOUGH))) - effort


def worth_of_least(separation: np.ndarray, needs: int) -> float:
    """Least distance of the pairs, of which no more counts than is enough, less the number of things needed:
    the worth in a diagnosis, whose rivals are few and must all be told apart.
    """
    return min(float(np.min(pairs(separation))), ENOUGH) - EFFORT_OF_NEED * needs


def sd_after(model: OpenModel, slopes: np.ndarray) -> np.ndarray:
    """Standard deviation of each number after an experiment, SI, (p,), from the Fisher information.

    Args:
        model: that is true.
        slopes: derivatives of the readings in standard deviations of their noise, (n, p).
    """
    covariance = np.linalg.inv(model.information + slopes.T @ slopes)
    return np.asarray([n.sd for n in model.numbers]) * np.sqrt(np.diag(covariance))


def worth_of_narrowing(
    model: OpenModel, slopes: np.ndarray, wanted: np.ndarray, *, each: bool, effort: float
) -> float:
    """By how much intervals narrow, as a logarithm per number, less the effort.

    Args:
        model, slopes: as of `sd_after`.
        wanted: which numbers count, (p,) bool.
        each: whether the narrowing of each interval counts by itself; else the volume of all together (D),
            in which it also counts that they no longer trade off.
        effort: of the experiment.
    """
    if each:
        gain = float(np.mean(np.log(model.sd / sd_after(model, slopes))[wanted]))
    else:
        before, after = (
            np.linalg.slogdet(np.linalg.inv(information)[np.ix_(wanted, wanted)])[1]
            for information in (model.information, model.information + slopes.T @ slopes)
        )
        gain = float(before - after) / (2 * int(wanted.sum()))
    return gain - EFFORT_IN_LOGS * effort
