"""Estimates with their uncertainty, and which parameters the recording does not determine."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from .number import Number

# Half width of a 95 % interval, in standard errors.
NORMAL_95 = 1.959963984540054
# Standard errors of a change that is significant (two sides, 5 %) in 95 of 100 recordings.
DETECTED = NORMAL_95 + 1.6448536269514722
# A relative standard deviation this large (a factor of e) from the data alone is not knowledge.
UNKNOWN = 1.0
# A parameter that is zero in the robot file has no size to compare its error with: it counts as unknown if
# its standard error reaches this many coordinate units (`number.UNIT_SCALE`).
UNKNOWN_WITHOUT_SCALE = 10.0
# Eigenvalues of the scaled information below this count as zero; a coordinate with a larger component than
# this in their directions is unknown.
FLAT, INVOLVED = 1e-12, 1e-3
# Share of a variance below which its source is not named.
LITTLE = 0.005
# Above this share of the prior's precision, the estimate is said to rest on the prior.
MOSTLY_PRIOR = 0.5


@dataclasses.dataclass(frozen=True)
class Estimate:
    """One fitted parameter, SI.

    Attributes:
        name, key: short name, and key in the robot file.
        value: fitted value.
        sd: standard deviation; None where the recording does not determine the parameter.
        lower95, upper95: interval of 95 %, symmetric on the scale of `transform`; None with `sd`.
        initial: value in the robot file.
        unit: SI unit, "" if dimensionless.
        transform: "log" or "linear", the scale it was estimated on.
        note: what a reader must know of it, or "".
        detectable: smallest change of it that a recording like this would show: found significant at 5 % in
            95 of 100 (3.6 standard errors); None with `sd`.
        made_of: share of its variance by source: the cells' noise, and each number whose uncertainty the
            robot file states; empty with `sd` None.
    """

    name: str
    key: str
    value: float
    sd: float | None
    lower95: float | None
    upper95: float | None
    initial: float
    unit: str
    transform: str
    note: str = ""
    detectable: float | None = None
    made_of: Mapping[str, float] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, eq=False)
class Profile:
    """Profile likelihood of one parameter, SI, at n values.

    Attributes:
        values: of the parameter, increasing, (n,).
        rise: of the sum of squares, in variances, over its least, the other parameters fitted again, (n,).
        parabola: the same if it were the parabola of the standard error, (n,).
        lower95, upper95: where the rise passes 3.84; None where it does not within four standard errors.
    """

    values: np.ndarray
    rise: np.ndarray
    parabola: np.ndarray
    lower95: float | None
    upper95: float | None


def transform(log: bool) -> str:
    """Name of the scale a parameter is estimated on."""
    return "log" if log else "linear"


class Uncertainty(NamedTuple):
    """What the data and the priors say about p coordinates.

    Attributes:
        covariance: of data and priors together, (p, p); rows of unknown coordinates are NaN.
        known: which coordinates the data determine, (p,).
        alone: standard deviation of each from the data alone if all others were known, (p,); inf where they
            say nothing.
        prior_share: share of the precision that is the prior's, (p,).
    """

    covariance: np.ndarray
    known: np.ndarray
    alone: np.ndarray
    prior_share: np.ndarray


def uncertainty(jacobian: np.ndarray, sd: float, precision: np.ndarray, unknown: np.ndarray) -> Uncertainty:
    """Covariance of the coordinates from the Jacobian at the solution.

    Args:
        jacobian: derivatives of the weighed residuals by the coordinates, (D, p).
        sd: standard deviation of a weighed residual; 1 where the rows are weighed by the errors that the
            residual shows.
        precision: 1/sd of the priors, (p,); 0 without prior.
        unknown: standard deviation of each coordinate from the data alone at which it counts as unknown,
            (p,).

    Returns:
        A coordinate is unknown if the data alone, all other coordinates known, leave it a standard deviation
        above `unknown`; or if data and priors together do so, the others being uncertain.
    """
    p = jacobian.shape[1]
    data = jacobian.T @ jacobian / sd**2
    with np.errstate(divide="ignore"):
        alone = 1 / np.sqrt(np.diag(data))
    information = data + np.diag(precision**2)
    heard = np.flatnonzero(np.diag(information) > 0)
    known = np.zeros(p, bool)
    covariance = np.full((p, p), np.nan)
    if heard.size:
        unit = 1 / np.sqrt(np.diag(information)[heard])
        values, vectors = np.linalg.eigh(information[np.ix_(heard, heard)] * np.outer(unit, unit))
        flat = values < FLAT
        inverse = (vectors[:, ~flat] / values[~flat]) @ vectors[:, ~flat].T
        cov = inverse * np.outer(unit, unit)
        # A coordinate in a flat direction has no finite variance; unknown coordinates still widen the others.
        lost = (np.abs(vectors[:, flat]) > INVOLVED).any(axis=1)
        sure = ~lost & (np.sqrt(np.diag(cov)) <= unknown[heard]) & (alone[heard] < unknown[heard])
        known[heard] = sure
        kept = heard[sure]
        covariance[np.ix_(kept, kept)] = cov[np.ix_(sure, sure)]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(precision > 0, precision**2 * np.diag(covariance), 0.0)
    return Uncertainty(covariance=covariance, known=known, alone=alone, prior_share=share)


def shares_of_variance(
    rows: Mapping[str, np.ndarray], priors: Mapping[str, np.ndarray]
) -> tuple[list[str], np.ndarray]:
    """Where the variance of each coordinate comes from.

    The estimate is linear in the errors of the readings and of the prior means, which are independent: with A
    = sum J_k'J_k + sum p_j p_j' its covariance is the sum of A^-1 J_k'J_k A^-1 over the sources of noise and
    of A^-1 p_j p_j' A^-1 over the priors.

    Args:
        rows: derivatives of the weighed residuals by the coordinates, by source of noise, (D_k, p) each.
        priors: row of each prior, by source: 1/sd at its coordinate, (p,).

    Returns:
        Names of the sources, S of them, and their shares, (S, p): columns add up to 1, or are 0 where nothing
        is known.
    """
    names = [*rows, *priors]
    parts = [J.T @ J for J in rows.values()] + [np.outer(row, row) for row in priors.values()]
    total = np.sum(parts, axis=0)
    size = np.sqrt(np.maximum(np.diag(total), 0.0))
    unit = np.where(size > 0, 1 / np.where(size > 0, size, 1.0), 0.0)
    inverse = np.linalg.pinv(total * np.outer(unit, unit), rcond=FLAT, hermitian=True) * np.outer(unit, unit)
    each = np.stack([np.diag(inverse @ part @ inverse) for part in parts])
    whole = np.sum(each, axis=0)
    return names, np.where(whole > 0, each / np.where(whole > 0, whole, 1.0), 0.0)


def correlation(covariance: np.ndarray) -> np.ndarray:
    """Correlation matrix; NaN where a parameter is unknown."""
    sd = np.sqrt(np.diag(covariance))
    return covariance / np.outer(sd, sd)


def estimates(
    numbers: Sequence[Number],
    values: np.ndarray,
    initial: np.ndarray,
    found: Uncertainty,
    notes: Sequence[str],
    sources: tuple[Sequence[str], np.ndarray] = ((), np.zeros((0, 0))),
) -> list[Estimate]:
    """Estimates in SI from coordinates; see `Estimate`.

    Args:
        numbers: the free ones, p of them.
        values: fitted values, SI, (p,).
        initial: values before, SI.
        found: their uncertainty.
        notes: one per parameter, may be empty.
        sources: what their variance is made of, from `shares_of_variance`.
    """
    out, (labels, shares) = [], sources
    for i, number in enumerate(numbers):
        value, sd, lower, upper = float(values[i]), None, None, None
        if found.known[i]:
            spread = float(np.sqrt(found.covariance[i, i]))
            if number.log:
                sd = value * spread
                lower, upper = value * np.exp(-NORMAL_95 * spread), value * np.exp(NORMAL_95 * spread)
            else:
                sd = number.sd * spread
                lower, upper = value - NORMAL_95 * sd, value + NORMAL_95 * sd
            lower, upper = float(lower), float(upper)
        out.append(
            Estimate(
                name=number.name,
                key=number.key,
                value=value,
                sd=sd,
                lower95=lower,
                upper95=upper,
                initial=float(initial[i]),
                unit=number.unit,
                transform=transform(number.log),
                note=notes[i],
                detectable=None if sd is None else DETECTED * sd,
                made_of={}
                if sd is None
                else {n: float(x[i]) for n, x in zip(labels, shares, strict=True) if x[i] > LITTLE},
            )
        )
    return out
