"""Where to start: the cost scanned over friction, and stiffness, on a thinned recording.

The tip tension is a play operator of the base tension: locked stretches have no slope, and friction that is
much too high explains a recording by locking it. A descent alone would end there, so the start is searched
for.

Where the best end of these leaves more than the noise, the search goes wider: over orders of magnitude of the
numbers of physics terms, and through the models in which some of the free numbers are held. A law of which
two numbers act only together leaves valleys that a descent from one side does not cross.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import NamedTuple

import numpy as np

from calibrate.inference.coordinates import Coordinates
from calibrate.inference.descent import descend
from calibrate.inference.number import number_at
from calibrate.inference.objective import Objective
from calibrate.inference.parallel import in_parallel
from calibrate.inference.setup import Setup
from gtr_jax.robot.parameters import STIFFNESS, Parameter

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
# A sum of squares on the thinned recordings, in variances of the noise, that is no more than this for each
# reading is explained: there is nothing to search wider for.
EXPLAINED = 2.0
# Points tried for each number that the wider search varies.
POINTS = 16
# Share of the largest usual value down to which a size whose usual values begin at 0 is varied.
SMALLEST = 1e-2
# A model with fewer free numbers whose sum of squares on the thinned recordings is up to this many times the
# best is fitted to all samples, to see whether it does better there.
CLOSE = 1.5


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


def across(setup: Setup) -> list[np.ndarray]:
    """Values over the whole usual range of the numbers of physics terms that are free without prior, evenly
    and in no order (an additive recurrence), with friction over its grid's; [] where no such number is free.
    """
    varied = [i for i in range(len(setup.asked)) if setup.priors[i] is None]
    friction = [i for i in varied if i in setup.friction()]
    ranges = {i: usual for i in varied if (usual := _usual(setup.free[i].entry)) is not None}
    if not ranges:
        return []
    rows = [*([friction] if friction else []), *([i] for i in ranges)]
    spans = [*([(MU_GRID[0], MU_GRID[-1])] if friction else []), *ranges.values()]
    root = 2.0
    for _ in range(50):  # of x^(d+1) = x + 1, whose powers are as far from fractions as any
        root = (1 + root) ** (1 / (len(rows) + 1))
    points = np.outer(np.arange(1, POINTS * len(rows) + 1), root ** -np.arange(1.0, len(rows) + 1))
    tried = []
    for point in 0.5 + points:
        guess = np.array(setup.initial)
        for members, (low, high), share in zip(rows, spans, point % 1, strict=True):
            for i in members:
                log = number_at(setup.free[i].entry, guess[i]).log
                guess[i] = low * (high / low) ** share if log else low + (high - low) * share
        tried.append(guess)
    return tried


def _usual(entry: Parameter) -> tuple[float, float] | None:
    """The usual values of a number of a physics term; None of any other."""
    if entry.term is None:
        return None
    own = next((q for q in entry.term.quantities if entry.name == f"{entry.term.id}.{q.name}"), None)
    if own is None or not own.usual[1] > own.usual[0]:
        return None
    low, high = own.usual
    return (SMALLEST * high, high) if low == 0.0 and own.size else (low, high)


def nested(setup: Setup) -> list[np.ndarray]:
    """Which numbers stay as the robot file has them, (p,) bool each, in the models with fewer free numbers
    that a fit is compared with: all but one of those asked for are free, or friction alone.
    """
    kinds: dict[str, list[int]] = {}
    for i, free in enumerate(setup.asked):
        kinds.setdefault("mu" if i in setup.friction() else free.entry.name, []).append(i)
    if len(kinds) < 2:
        return []
    held = [np.isin(np.arange(len(setup.free)), members) for members in kinds.values()]
    if len(kinds) > 2 and "mu" in kinds:
        others = [i for name, members in kinds.items() if name != "mu" for i in members]
        held.append(np.isin(np.arange(len(setup.free)), others))
    return held


class Held(NamedTuple):
    """Where the best descent ended of a model that holds some of the free numbers: which, (p,) bool;
    coordinates of each recording; the point, (p,); and its sum of squares on the thinned recordings.
    """

    held: np.ndarray
    at: tuple[Coordinates, ...]
    u: np.ndarray
    cost: float


class Start(NamedTuple):
    """Where the fit begins.

    Attributes:
        at: coordinates of each recording.
        u: the point, (p,).
        tried: starts from which a descent was tried.
        agreed: how many of them ended where the best did, or as low.
        evaluations: times that all recordings were simulated.
        nested: the best model with fewer free numbers, where it does not do clearly worse than this on the
            thinned recordings; or None.
    """

    at: tuple[Coordinates, ...]
    u: np.ndarray
    tried: int
    agreed: int
    evaluations: int
    nested: Held | None = None


class _Scanned(NamedTuple):
    """A candidate: its sum of squares, the problem with its origin there, coordinates of each recording."""

    cost: float
    problem: Objective
    at: tuple[Coordinates, ...]


class _End(NamedTuple):
    """Where a descent from a start ended: its sum of squares, coordinates of each recording, the point (p,),
    and how often all recordings were simulated.
    """

    cost: float
    at: tuple[Coordinates, ...]
    u: np.ndarray
    evaluations: int


def search(setup: Setup) -> Start | None:
    """Scan the candidates on the thinned recordings and descend from the best few of them; where they leave
    more than the noise, do so again with values `across` what the terms allow, and with `nested` models.

    Returns:
        The best end; None if the simulation fails at every candidate.
    """
    samples = [
        np.unique(np.concatenate([thin(drive.T_base) for drive in part.drives])) for part in setup.parts
    ]
    thinned = [part.only(kept) for part, kept in zip(setup.parts, samples, strict=True)]
    tried = candidates(setup)
    origin = np.zeros(len(setup.free))

    def scan(i: int) -> _Scanned:
        setup.progress(f"searching for a start: {i + 1} of {len(tried)}")
        return scanned_at(tried[i])

    def scanned_at(values: np.ndarray, held: np.ndarray | None = None) -> _Scanned:
        at = setup.coordinates(values, held)
        problem = Objective.of(setup, at, thinned)
        return _Scanned(problem.cost(origin, problem.predict(origin)), problem, at)

    def rough(i: int) -> _End:
        setup.progress(f"descending from start {i + 1}")
        return end_of(scanned[i])

    def end_of(start: _Scanned) -> _End:
        found = descend(start.problem, origin, max_steps=ROUGH_STEPS)
        cost = start.problem.cost(found.u, found.predictions)
        u = np.where(found.at_edge, origin, found.u)
        return _End(cost=cost, at=start.at, u=u, evaluations=found.evaluations)

    def end_without(held: np.ndarray) -> tuple[Held | None, int]:
        """Where the model that holds these ends, and simulations."""
        friction = [i for i in setup.friction() if not held[i] and setup.priors[i] is None]
        guesses = [np.array(setup.initial)]
        for mu in MU_GRID if friction else ():
            guesses.append(np.array(setup.initial))
            guesses[-1][friction] = mu
        every = [scanned_at(guess, held) for guess in guesses]
        start = min(every, key=lambda entry: entry.cost)
        if not np.isfinite(start.cost):
            return None, len(every)
        found = descend(start.problem, origin, active=~held, max_steps=ROUGH_STEPS)
        cost = start.problem.cost(found.u, found.predictions)
        return Held(held, start.at, found.u, cost), len(every) + found.evaluations

    scanned = _sorted(in_parallel(scan, range(len(tried))))
    ends = in_parallel(rough, range(len(scanned[:STARTS])))
    if not ends:
        return None
    evaluations = len(tried) + sum(end.evaluations for end in ends)
    best, beside = min(ends, key=lambda end: end.cost), None
    without = nested(setup)
    if without and best.cost > EXPLAINED * sum(part.recorded.size for part in thinned):
        setup.progress("searching more widely for a start")
        wide = across(setup)
        further = in_parallel(end_of, _sorted(in_parallel(scanned_at, wide))[:STARTS])
        evaluations += len(wide) + sum(end.evaluations for end in further)
        lower = min([best, *further], key=lambda end: end.cost)
        if lower.cost < best.cost - max(LEVEL, LEVEL * best.cost):
            best = lower
        ends += further
        held = in_parallel(end_without, without)
        evaluations += sum(count for _, count in held)
        known = [end for end, _ in held if end is not None]
        beside = min(known, key=lambda end: end.cost, default=None)
        if beside is not None and beside.cost > CLOSE * best.cost:
            beside = None
    return Start(
        at=best.at,
        u=best.u,
        tried=len(ends),
        agreed=sum(end.cost <= best.cost + max(LEVEL, LEVEL * best.cost) for end in ends),
        evaluations=evaluations,
        nested=beside,
    )


def _sorted(scanned: list[_Scanned]) -> list[_Scanned]:
    """Those at which the simulation succeeds, the best first."""
    return sorted((s for s in scanned if np.isfinite(s.cost)), key=lambda s: s.cost)


class Beaten(NamedTuple):
    """A model with fewer free numbers that leaves less than a fit: which it holds, (p,) bool, and the root
    mean square that it leaves at the tips [N], NaN without any.
    """

    held: np.ndarray
    rms: float


def beaten(setup: Setup, problem: Objective, cost: float, start: Start) -> tuple[Beaten | None, int]:
    """Whether the best model with fewer free numbers leaves less than a fit, on all samples; None if it does
    not; and how often all recordings were simulated.

    Args:
        setup: what is fitted.
        problem: as it was solved, with its weights.
        cost: the sum of squares where its descent ended.
        start: from where it began.
    """
    other = start.nested
    if other is None:
        return None, 0
    setup.progress("fitting with fewer free numbers")
    fewer = dataclasses.replace(Objective.of(setup, other.at), weighs=problem.weighs)
    found = descend(fewer, other.u, active=~other.held, max_steps=ROUGH_STEPS)
    least = fewer.cost(found.u, found.predictions)
    if found.predictions is None or not least < cost - max(LEVEL, LEVEL * cost):
        return None, found.evaluations
    left = [
        part.residual(prediction)[: part.tips].ravel()
        for part, prediction in zip(setup.parts, found.predictions, strict=True)
    ]
    rms = float(np.sqrt(np.mean(np.concatenate(left) ** 2))) if any(row.size for row in left) else np.nan
    return Beaten(other.held, rms), found.evaluations
