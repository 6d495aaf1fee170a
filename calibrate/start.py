"""Where to start: the cost scanned over friction, and stiffness, on a thinned recording.

The tip tension is a play operator of the base tension: locked stretches have no slope, and friction that is
much too high explains a recording by locking it. A descent alone would end there, so the start is searched
for.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from gtr_jax.robot.parameters import STIFFNESS

from .coordinates import Coordinates
from .descent import Objective, descend
from .parallel import in_parallel
from .setup import Setup

# Friction coefficients tried: factors below 2 between neighbours, from a smooth sheath to full lock.
MU_GRID = tuple(float(mu) for mu in np.geomspace(0.01, 2.0, 10))
# Factors on the stiffness of the robot file that are tried.
E_FACTORS = (1.0, 0.4, 2.5)
# Blocks of a thinned recording, with two samples each.
BLOCKS = 60
# Candidates from which a descent is tried.
STARTS = 3
# Ends whose sums of squares differ by less than this, in variances or relative, count as one.
LEVEL = 0.01
# Steps of a descent on the thinned recordings.
ROUGH_STEPS = 25


def thin(T_base: np.ndarray, blocks: int = BLOCKS) -> np.ndarray:
    """Samples that carry the load history: of each of so many blocks the lowest and the highest base tension.

    A tendon with friction remembers extremes, so nothing is averaged.

    Args:
        T_base: base tension [N], (K,).
        blocks: number of blocks.

    Returns:
        Increasing indices, at most 2 per block, with the first and the last sample.
    """
    K = len(T_base)
    if 2 * blocks >= K:
        return np.arange(K)
    edges = np.linspace(0, K, blocks + 1).astype(int)
    kept = {0, K - 1}
    for a, b in itertools.pairwise(edges):
        kept |= {a + int(np.argmin(T_base[a:b])), a + int(np.argmax(T_base[a:b]))}
    return np.asarray(sorted(kept))


def candidates(setup: Setup) -> list[np.ndarray]:
    """Values worth trying, SI: the robot file's, and a grid over mu and the stiffness where they have no
    prior. Where recordings or tendons have values of their own, or several numbers give the stiffness, all
    are changed alike.
    """
    values = setup.initial
    searched = {
        what: [
            i
            for i, f in enumerate(setup.free)
            if f.entry.name.partition(".")[0] in names and setup.priors[i] is None
        ]
        for what, names in (("mu", ("mu",)), ("stiffness", STIFFNESS))
    }
    tried = []
    for mu, factor in itertools.product(
        [None, *MU_GRID] if searched["mu"] else [None], E_FACTORS if searched["stiffness"] else (1.0,)
    ):
        guess = np.array(values)
        guess[searched["stiffness"]] *= factor
        if mu is not None:
            guess[searched["mu"]] = mu
        if np.all(guess[searched["mu"]] > 0):
            tried.append(guess)
    return tried


class Start(NamedTuple):
    """Where the fit begins.

    Attributes:
        at: coordinates of each recording.
        u: the point, (p,).
        tried: starts from which a descent was tried.
        agreed: how many of them ended where the best did, or as low.
        evaluations: times that all recordings were simulated.
    """

    at: tuple[Coordinates, ...]
    u: np.ndarray
    tried: int
    agreed: int
    evaluations: int


class _End(NamedTuple):
    """Where a descent from a start ended: its sum of squares, coordinates of each recording, the point (p,),
    and how often all recordings were simulated.
    """

    cost: float
    at: tuple[Coordinates, ...]
    u: np.ndarray
    evaluations: int


def search(setup: Setup) -> Start | None:
    """Scan the candidates on the thinned recordings and descend from the best few of them.

    Returns:
        The best end; None if the simulation fails at every candidate.
    """
    samples = [
        np.unique(np.concatenate([thin(drive.T_base) for drive in part.drives])) for part in setup.parts
    ]
    thinned = [part.only(kept) for part, kept in zip(setup.parts, samples, strict=True)]
    tried = candidates(setup)
    origin = np.zeros(len(setup.free))

    def scan(i: int) -> tuple[float, Objective, tuple[Coordinates, ...]]:
        setup.progress(f"searching for a start: {i + 1} of {len(tried)}")
        at = setup.coordinates(tried[i])
        problem = setup.objective(at, thinned)
        return problem.cost(origin, problem.predict(origin)), problem, at

    def rough(i: int) -> _End:
        setup.progress(f"descending from start {i + 1}")
        _, problem, at = scanned[i]
        found = descend(problem, origin, max_steps=ROUGH_STEPS)
        cost = problem.cost(found.u, found.predictions)
        u = np.where(found.at_edge, origin, found.u)
        return _End(cost=cost, at=at, u=u, evaluations=found.evaluations)

    scanned = [entry for entry in in_parallel(scan, range(len(tried))) if np.isfinite(entry[0])]
    scanned.sort(key=lambda entry: entry[0])
    ends = in_parallel(rough, range(len(scanned[:STARTS])))
    if not ends:
        return None
    best = min(ends, key=lambda end: end.cost)
    return Start(
        at=best.at,
        u=best.u,
        tried=len(ends),
        agreed=sum(end.cost <= best.cost + max(LEVEL, LEVEL * best.cost) for end in ends),
        evaluations=len(tried) + sum(end.evaluations for end in ends),
    )
