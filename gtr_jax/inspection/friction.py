"""Rough friction: the ratio of the tensions on pull and on release, at the same base tension."""

from __future__ import annotations

import dataclasses

import numpy as np

from gtr_jax.recordings.signals.differences import MAD_TO_SD

from .slip import PULLING, RELEASING, Phases

# Levels of the base tension at which both branches are compared, from this share of its largest value on.
LEVELS, LOWEST = 24, 0.15
FEWEST = 4  # steps of a branch at one level, and levels with both branches
# The sum of the branches is none if it is within so many standard errors, or this share of the friction.
SURE, LITTLE = 3.0, 0.05
IN_COMMON = 0.005  # of ln(T_tip/T_base): what all levels may have in common, as the zeros of the cells
THIN = 0.02  # a loop of less than this share of the rectangle around it has no sense


@dataclasses.dataclass(frozen=True, eq=False)
class Friction:
    """The two branches of slip.

    Attributes:
        T_base: levels [N], (n,).
        pulling, releasing: median of T_tip/T_base at each level, (n,); NaN where there is no slip.
        mu_theta: half the difference of ln(T_tip/T_base) between release and pull, median over the levels
            with both: friction coefficient times wrap, on Coulomb's law; None where too few have both.
        mu_theta_sd: its standard error, from how the levels scatter.
        both: half the sum: what friction that is alike both ways cannot do.
        both_sd: its standard error.
        base_leads: whether the loop of T_tip over T_base runs as friction makes it run if the base drives:
            the tip lower on the pull; None where the loop is too thin to tell.
        symmetric: whether pull and release lie as far from 1, in logarithms; None where it is not known.
    """

    T_base: np.ndarray
    pulling: np.ndarray
    releasing: np.ndarray
    base_leads: bool | None = None
    mu_theta: float | None = None
    mu_theta_sd: float | None = None
    both: float | None = None
    both_sd: float | None = None
    symmetric: bool | None = None


def friction(T_base: np.ndarray, T_tip: np.ndarray, phases: Phases) -> Friction:
    """Friction by the ratio of the tensions.

    Args:
        T_base, T_tip: tensions without the zeros of the cells [N], (K,).
        phases: from `slip.phases`.
    """
    highest = float(np.max(T_base))
    edges = np.linspace(LOWEST * highest, highest, LEVELS + 1)
    middle = phases.steps.mean(axis=1).astype(int)
    base, tip = T_base[middle], T_tip[middle]
    branches = []
    for phase in (PULLING, RELEASING):
        own = (phases.of_step == phase) & (base > edges[0]) & (tip > 0)
        place = np.searchsorted(edges, base[own]) - 1
        ratio = tip[own] / base[own]
        branches.append(
            np.asarray(
                [np.median(ratio[place == i]) if np.any(place == i) else np.nan for i in range(LEVELS)]
            )
        )
    pulling, releasing = branches
    at = 0.5 * (edges[1:] + edges[:-1])
    logs = np.log(pulling), np.log(releasing)
    half_difference, half_sum = 0.5 * (logs[1] - logs[0]), 0.5 * (logs[1] + logs[0])
    known = np.isfinite(half_difference)
    leads = _base_leads(T_base, T_tip)
    n = int(known.sum())
    if n < FEWEST:
        return Friction(at, pulling, releasing, leads)
    (D, D_sd), (S, S_sd) = (_middle(values[known]) for values in (half_difference, half_sum))
    return Friction(
        at, pulling, releasing, leads, D, D_sd, S, S_sd, symmetric=abs(S) <= max(SURE * S_sd, LITTLE * abs(D))
    )


def _base_leads(T_base: np.ndarray, T_tip: np.ndarray) -> bool | None:
    """The sense in which the loop runs, by the area it encloses."""
    own = 0.5 * (T_tip[1:] + T_tip[:-1]) * np.diff(T_base)
    area = float(np.sum(own)) - 0.5 * float(T_tip[0] + T_tip[-1]) * float(T_base[-1] - T_base[0])
    if abs(area) < THIN * float(np.ptp(T_base) * np.ptp(T_tip)):
        return None
    return area < 0


def _middle(values: np.ndarray) -> tuple[float, float]:
    """The median of the levels, which a few with little slip do not move, and its standard error."""
    middle = float(np.median(values))
    spread = MAD_TO_SD * float(np.median(np.abs(values - middle)))
    return middle, float(np.hypot(np.sqrt(np.pi / 2) * spread / np.sqrt(len(values)), IN_COMMON))
