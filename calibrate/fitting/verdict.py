"""The answer of a fit in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from scipy.special import fdtri

from calibrate.inference.channels import words_of
from calibrate.inference.estimate import Estimate
from gtr_jax.numbers import measured, measured_quantity
from gtr_jax.simulation.phases import PULLING, RELEASING, REST, TRANSITION

# Above this chi-square per sample the residual is more than noise (1.22 times the noise); where the noise is
# poorly known, above the value that chance exceeds in 1 of 100 recordings.
LACK_OF_FIT, CHANCE = 1.5, 0.01
# A residual below this share of the peak is called small even if the noise is smaller still.
SMALL = 0.0025
# Standard errors of the difference between pulling and releasing from which they disagree.
DISAGREE = 3.0
# Share of a variance above which uncertain numbers make most of it, and from which each of them is named.
MOST_OF_IT, NAMED = 0.5, 0.1


def number(value: float, sd: float | None) -> str:
    """A value with its standard deviation, to two digits of the latter."""
    return measured(value, sd) if math.isfinite(value) else "unknown"


def in_words(estimate: Estimate) -> str:
    """A parameter, its value and unit."""
    if estimate.sd is None and "no friction" in estimate.note:
        return estimate.note
    if estimate.sd is None:
        return f"{estimate.name} is not determined"
    return f"{estimate.name} = {quantity(estimate)}{_owing_to(estimate)}"


def _owing_to(estimate: Estimate) -> str:
    """The other numbers whose uncertainty makes most of an estimate's, in brackets; "" where noise does."""
    numbers = {n: x for n, x in estimate.made_of.items() if not n.startswith("noise") and n != estimate.name}
    if sum(numbers.values()) < MOST_OF_IT:
        return ""
    named = sorted((n for n, x in numbers.items() if x >= NAMED), key=lambda n: -numbers[n])
    return f" (most of the ± is the uncertainty of {' and '.join(named)} in the robot file)" if named else ""


def quantity(estimate: Estimate) -> str:
    """An estimate with its standard deviation, in the unit people write it in."""
    return measured_quantity(estimate.value, estimate.sd, estimate.unit)


def by_phase(residual: np.ndarray, phases: np.ndarray) -> dict[str, dict[str, float]]:
    """Count, root mean square and mean of the residual [N] in each phase that occurs."""
    table = {}
    for phase in (PULLING, TRANSITION, RELEASING, REST):
        r = residual[phases == phase]
        if r.size:
            table[phase] = {
                "count": int(r.size),
                "rms_N": float(np.sqrt(np.mean(r**2))),
                "mean_N": float(np.mean(r)),
            }
    return table


def disagreement_of_phases(mu_by_phase: dict[str, Estimate], apart: float) -> str:
    """One clause if the friction of pulling and releasing lie `DISAGREE` standard errors apart, else ""."""
    pull, release = mu_by_phase.get(PULLING), mu_by_phase.get(RELEASING)
    if pull is None or release is None or apart <= DISAGREE:
        return ""
    return (
        f"pulling alone would give mu = {number(pull.value, pull.sd)}, "
        f"releasing alone mu = {number(release.value, release.sd)}"
    )


def by_chance(degrees: float, noise_degrees: float, among: int = 1) -> float:
    """Value that chi-square per degree of freedom exceeds by chance in a share CHANCE of recordings; the
    largest of it among several channels.
    """
    if not math.isfinite(degrees):
        return 1.0
    return float(fdtri(degrees, min(noise_degrees, 1e6), 1 - CHANCE / among))


def most_of_noise(samples: int, among: int) -> float:
    """Mean square of a channel's residual, over that of its noise, up to which it is described; the noise is
    told from third differences, and so many channels are compared.
    """
    # Third differences of samples tell a variance as a third as many independent readings would. How long the
    # residual remembers is not counted: that of a misfit is long, and would excuse it.
    return max(LACK_OF_FIT, by_chance(samples, samples / 3, among=among))


class Distance(NamedTuple):
    """How far the fitted model is from one recording.

    Attributes:
        name: of the recording.
        rms: of the residual, outliers left out [N].
        outliers: how many these are.
        peak: largest recorded tip tension [N].
        noise: of the recording [N], or None.
        chi2: sum of squares per degree of freedom in units of the noise, or None.
        degrees: degrees of freedom of that sum, and of the noise.
        table: from `by_phase`.
        others: name, rms, noise and unit of the other channels that the model does not describe.
    """

    name: str
    rms: float
    outliers: int
    peak: float
    noise: float | None
    chi2: float | None
    degrees: tuple[float, float]
    table: dict[str, dict[str, float]]
    others: list[tuple[str, float, float, str]]

    @property
    def off(self) -> str:
        """In words."""
        share = f", {100 * self.rms / self.peak:.2g} % of the {self.peak:.3g} N peak" if self.peak > 0 else ""
        but = f" without {self.outliers} outliers" if self.outliers else ""
        return f"{self.rms:.3g} N rms{share}{but}"

    @property
    def where(self) -> str:
        """By phase, in words."""
        return "by phase " + ", ".join(
            f"{k} {v['rms_N']:.2g} N (mean {v['mean_N']:+.2g})" for k, v in self.table.items()
        )

    @property
    def tensions_described(self) -> bool:
        """Whether the residual of the tensions is no more than noise."""
        if self.chi2 is None:
            return False
        return self.chi2 <= max(LACK_OF_FIT, by_chance(*self.degrees))

    @property
    def described(self) -> bool:
        """Whether the residuals of all that was compared are no more than noise."""
        return self.tensions_described and not self.others

    def clauses(self) -> list[str]:
        """How the model describes this recording; the first clause begins a sentence or follows "but"."""
        if self.noise is None or self.chi2 is None:
            clauses = [
                f"the fitted model is {self.off}, from the recording, whose noise cannot be estimated",
                self.where,
            ]
        elif self.tensions_described and self.others:
            clauses = [
                "the fitted model describes only the tensions of the recording to their noise: "
                f"{self.off}, noise {self.noise:.2g} N"
            ]
        elif self.tensions_described:
            clauses = [
                f"the fitted model describes the recording to its noise: {self.off}, noise {self.noise:.2g} N"
            ]
        elif self.rms <= SMALL * self.peak:
            clauses = [
                f"the fitted model is close to the recording: off by {self.off}; "
                f"noise explains {self.noise:.2g} N"
            ]
        else:
            begin = f"the fitted model does not describe the recording: it is off by {self.off}"
            clauses = [begin, f"noise explains only {self.noise:.2g} N", self.where]
        return [*clauses, *(_other(*o) for o in self.others)]

    @property
    def bad(self) -> bool:
        """Whether the model falls short of the recording."""
        if self.others:
            return True
        known = self.noise is not None and self.chi2 is not None
        return known and not (self.tensions_described or self.rms <= SMALL * self.peak)


def in_unit(value: float, unit: str, digits: int = 2) -> str:
    """A value in an SI unit to two digits, or others, in the unit people write it in."""
    factor, shown = {"m": (1e3, "mm"), "rad": (math.degrees(1.0), "°"), "N": (1.0, "N")}[unit]
    return f"{factor * value:.{digits}g} {shown}"


def _other(name: str, rms: float, noise: float, unit: str) -> str:
    return (
        f"{words_of(name)} is off by {in_unit(rms, unit)} rms, neighbouring samples by {in_unit(noise, unit)}"
    )


class Described(Protocol):
    """How far the fitted model is from one recording, whatever was recorded."""

    @property
    def name(self) -> str:
        """Of the recording."""
        ...

    @property
    def described(self) -> bool:
        """Whether the residuals of all that was compared are no more than noise."""
        ...

    @property
    def bad(self) -> bool:
        """Whether the model falls short of the recording."""
        ...

    def clauses(self) -> list[str]:
        """How the model describes this recording."""
        ...


def values_apart(name: str, alone: dict[str, Estimate]) -> str:
    """A parameter's value from each recording alone, as a clause."""
    return f"{name}: " + ", ".join(f"{quantity(e)} from {which}" for which, e in alone.items())


def verdict(
    estimates: Sequence[Estimate],
    distances: Sequence[Described],
    *,
    disagreement: str,
    failure: str,
) -> str:
    """One sentence: what was found, how far the model is from the recordings, and where.

    Args:
        estimates: the fitted parameters.
        distances: of each recording.
        disagreement: of phases or recordings, or "".
        failure: why there is no answer, or "".
    """
    if failure:
        return f"No answer: {failure}."
    found = ", ".join(in_words(e) for e in estimates)
    if len(distances) == 1:
        only = distances[0]
        clauses = [f"{found}{', but' if only.bad else ';'} {only.clauses()[0]}", *only.clauses()[1:]]
    else:
        good = [d for d in distances if d.described]
        if len(good) == len(distances):
            every = "both" if len(distances) == 2 else f"all {len(distances)}"
            clauses = [f"{found}; the fitted model describes {every} recordings to their noise"]
        else:
            share = f"{len(good)} of {len(distances)} recordings"
            clauses = [f"{found}, but the fitted model describes {share} to their noise"]
            clauses += [
                f"{d.name}: {'; '.join(d.clauses()).replace('the recording', 'it')}"
                for d in distances
                if d not in good
            ]
    return "; ".join([*clauses, disagreement] if disagreement else clauses) + "."
