"""Where a simulation and a recording differ: by phase, tension, cycle, rate and channel."""

from __future__ import annotations

import dataclasses
import itertools
from typing import NamedTuple

import numpy as np
from scipy import signal, stats

from gtr_jax.phases import PULLING, RELEASING, TRANSITION, phases_of_slip

from ..base_tension import turning_points
from ..coordinates import CHANNEL_UNITS, CHANNELS
from ..noise import MAD_TO_SD, resolution
from .bench import Bench, Fitted

PHASES = (PULLING, TRANSITION, RELEASING)
FEWEST, SEEN = 4, 3.5
# Chance below which a swinging residual is no noise, from sample to sample and with a tension (on 70 sound
# recordings of the blind benchmark the least were 3e-6 and 5e-4), and the share of it that has to swing: in
# long recordings the least that noise is not what it is taken for is significant.
SWINGS, PERIODIC, SWING_SHARE = 1e-7, 5e-5, 0.3
# Lags; samples, and waves over the range of a tension, below which nothing is said; frequencies by a peak.
LAGS, FEWEST_WAVES, FEWEST_WAVES_ALONG, BESIDE = (3, 12), 40, 4, 25
# Single readings count for their size up to so many standard deviations, unless one in fifty is beyond.
LONE, RARE = 4.0, 0.98
MOST = 6


@dataclasses.dataclass(frozen=True)
class Where:
    """A part of the recordings in which simulation and recording differ.

    Attributes:
        recording: its name.
        channel: what differs there, "T_tip" unless pose or displacement show it better.
        phase: "pulling", "transition" or "releasing", or "" for all.
        T_base_N: range of the base tension [N].
        cycle: number of the cycle, from 1; None for all.
        mean, excess_rms: simulated minus recorded, and its size beyond the noise, in `unit`.
        unit: N, m or rad.
        z: significance of the mean, in standard errors.
        share: of the misfit of this channel.
        says: the same in words.
    """

    recording: str
    channel: str
    phase: str
    T_base_N: tuple[float, float]
    cycle: int | None
    mean: float
    excess_rms: float
    unit: str
    z: float
    share: float
    says: str


def phases_of(bench: Bench, fitted: Fitted, k: int) -> np.ndarray:
    """Phase of each sample of recording k under a fit, (K,) of str."""
    seen = fitted.seen[k]
    return phases_of_slip(seen.slips, seen.direction, first=PULLING)


def cycles_of(T_base: np.ndarray) -> np.ndarray:
    """Number of the cycle of each sample, from 1: a cycle ends where the tension turns up again from near its
    lowest, (K,).
    """
    span = float(np.ptp(T_base))
    turns = turning_points(T_base, 0.25 * span)
    low = [k for k in turns[1:-1] if T_base[k] < np.min(T_base) + 0.3 * span]
    return 1 + np.searchsorted(np.asarray(low, int), np.arange(len(T_base)), side="right")


def _strata(T: np.ndarray, phases: np.ndarray, cycle: np.ndarray):
    """Phases by ranges of tension, and cycles: label, phase, cycle and samples of each."""
    edges = np.linspace(float(T.min()), float(T.max()) + 1e-9, 5)
    for phase in PHASES:
        inside = phases == phase
        for low, high in itertools.pairwise(edges):
            yield phase, None, inside & (T >= low) & (T < high)
    if cycle[-1] > 1:
        for phase in ("pulling", "releasing"):
            for c in range(1, int(cycle[-1]) + 1):
                yield phase, c, (phases == phase) & (cycle == c)


def locate(bench: Bench, fitted: Fitted) -> list[Where]:
    """The parts in which a fit and the recordings differ by more than noise, those with most of the misfit
    first.
    """
    found = []
    for k, (rig, residual) in enumerate(zip(bench.rigs, bench.residuals(fitted.seen), strict=True)):
        T, part = rig.part.T_base.T_base, rig.part
        phases, cycle = phases_of(bench, fitted, k), cycles_of(rig.part.T_base.T_base)
        for c, (name, row) in enumerate(zip(part.channels, residual, strict=True)):
            noise = bench.noise[k][c]
            off = row - row.mean() if name == "displacement" else row
            # Samples per independent one, and the base tension's noise, which passes on where the tip slips.
            tau = (1 + noise.rho) / (1 - noise.rho)
            slope = bench.weighs[k].slope[c] if bench.weighs[k].sd_base > 0 else np.zeros(len(T))
            variance = noise.sd**2 + (slope * bench.weighs[k].sd_base) ** 2
            total = float(np.sum(np.maximum(off**2 - variance, 0.0)))
            for phase, number, inside in _strata(T, phases, cycle):
                n = int(inside.sum())
                if n < FEWEST:
                    continue
                mean, expected = float(off[inside].mean()), float(variance[inside].mean())
                z = mean / np.sqrt(expected * tau / n)
                excess = float(np.sqrt(max(np.mean(off[inside] ** 2) - expected, 0.0)))
                chi = (np.mean(off[inside] ** 2) / expected - 1) * np.sqrt(n / (2 * tau))
                if max(abs(z), chi) < SEEN:
                    continue
                share = float(np.sum(np.maximum(off[inside] ** 2 - variance[inside], 0.0))) / max(
                    total, 1e-300
                )
                reach = (float(T[inside].min()), float(T[inside].max()))
                unit = CHANNEL_UNITS[CHANNELS.index(name)]
                found.append(
                    Where(
                        part.name,
                        name,
                        phase,
                        reach,
                        number,
                        mean,
                        excess,
                        unit,
                        float(z),
                        share,
                        _words(name, phase, reach, number, mean, excess, unit),
                    )
                )
    by_tension = sorted((w for w in found if w.cycle is None), key=lambda w: (w.channel != "T_tip", -w.share))
    by_cycle = sorted(
        (w for w in found if w.cycle is not None and w.channel == "T_tip"), key=lambda w: -w.share
    )
    return [*by_tension[:MOST], *by_cycle[: MOST // 2]]


def _words(name, phase, reach, cycle, mean, excess, unit) -> str:
    factor, shown = {"N": (1.0, "N"), "m": (1e3, "mm"), "rad": (180 / np.pi, "deg")}[unit]
    sense = "too high" if mean > 0 else "too low"
    where = f"while {phase}" if phase != "transition" else "in the transition"
    which = f", cycle {cycle}" if cycle is not None else ""
    return (
        f"{where}{which}, {reach[0]:.3g} to {reach[1]:.3g} N at the base: simulated {name} {sense} by "
        f"{abs(mean) * factor:.2g} {shown} in the mean, {excess * factor:.2g} {shown} rms beyond the noise"
    )


def misfit(bench: Bench, fitted: Fitted) -> tuple[float, float]:
    """How much structure a fit leaves: rms of the white residuals beyond noise, in standard deviations of it,
    and its significance in standard errors.

    Significance is that of sums over neighbouring samples, whose noise is independent once white.
    """
    energy, count, blocks, squares = 0.0, 0, 0, 0.0
    for z in bench.by_channel(fitted.rows):
        C, K = z.shape
        length = int(np.clip(K // 12, 3, 10))
        n = K // length
        sums = z[:, : n * length].reshape(C, n, length).sum(axis=2) / np.sqrt(length)
        limit = max(LONE, float(np.quantile(np.abs(z), RARE)))
        energy, count = energy + float(np.sum(np.clip(z, -limit, limit) ** 2)), count + z.size
        blocks, squares = blocks + sums.size, squares + float(np.sum(sums**2))
    free = len(fitted.x)
    excess = np.sqrt(max(energy / max(count - free, 1) - 1, 0.0))
    return float(excess), float((squares - blocks + min(free, blocks // 2)) / np.sqrt(2 * blocks))


def waves(bench: Bench, fitted: Fitted) -> Waves | None:
    """Whether what a fit leaves of T_tip swings: with the tip's tension or the base's, as a cell does whose
    gain waves, or from sample to sample, as an amplifier does that rings. Differences of neighbours, from
    which the noise is taken, do not tell such swings from noise. None where there are none.
    """
    best: Waves | None = None
    for k, rig in enumerate(bench.rigs):
        z, step = bench.by_channel(fitted.rows)[k][0], resolution(rig.part.T_tip)
        rough = MAD_TO_SD * float(np.median(np.abs(z - np.median(z))))
        if len(z) < FEWEST_WAVES or rough == 0:
            continue
        z = np.clip(z - np.median(z), -3 * rough, 3 * rough)
        found = [Waves(rig.part.name, "sample", *_swinging(z), float("nan"))]
        for name, along in (("T_tip", fitted.seen[k].values[0]), ("T_base", rig.part.T_base.T_base)):
            found.append(Waves(rig.part.name, name, *_periodic(z, along, step)))
        for one in found:
            allowed = SWINGS if one.along == "sample" else PERIODIC
            counts = one.chance < allowed / len(bench.rigs) and one.share > SWING_SHARE
            if counts and (best is None or one.chance < best.chance):
                best = one
    return best


class Waves(NamedTuple):
    """A residual of T_tip that swings: recording, along what, how probable that is by chance, the share of
    its energy that swings, and the period [N].
    """

    recording: str
    along: str
    chance: float
    share: float
    period_N: float

    @property
    def says(self) -> str:
        """In words."""
        if self.along == "sample":
            return "what is left of T_tip swings from sample to sample"
        return f"what is left of T_tip swings with {self.along}, with a period of {self.period_N:.2g} N"


def _swinging(z: np.ndarray) -> tuple[float, float]:
    """Chance that white noise is as like itself some samples later (Ljung and Box), the next two left out;
    and how unlike itself it is where it is most so, or 1.2 times how like itself later on if that is less:
    memory, of a filter or a slow misfit, does not come back.
    """
    n, z = len(z), z - z.mean()
    lags = np.arange(LAGS[0], LAGS[1] + 1)
    likeness = np.asarray([float(np.sum(z[lag:] * z[:-lag])) for lag in lags]) / float(np.sum(z**2))
    chance = stats.chi2.sf(n * (n + 2) * np.sum(likeness**2 / (n - lags)), len(lags))
    lowest = int(np.argmin(likeness))
    back = float(np.max(likeness[lowest + 1 :], initial=0.0))
    return float(chance), max(0.0, min(-float(likeness[lowest]), 1.2 * back))


def _periodic(z: np.ndarray, along: np.ndarray, step: float) -> tuple[float, float, float]:
    """Chance that the highest peak of noise's periodogram stands out as far from those beside it, its share
    of the energy, and its period, in the unit of `along`; periods of a fourth of the range and shorter, and
    of more than four steps of the readings.
    """
    span, n = float(np.ptp(along)), len(z)
    u = (along - along.min()) / span if span > 0 else np.zeros(n)
    highest = min(n / 4, 0.5 * len(np.unique(np.round(u, 3))), span / (4 * step) if step > 0 else np.inf)
    if highest < 2 * FEWEST_WAVES_ALONG:
        return 1.0, 0.0, float("nan")
    # What is slow would come back at the frequencies at which equal ramps are sampled.
    angles = 2 * np.pi * u[:, None] * np.arange(0.5, FEWEST_WAVES_ALONG, 0.5)
    slow = np.concatenate([np.ones((n, 1)), np.cos(angles), np.sin(angles)], axis=1)
    z = z - slow @ np.linalg.lstsq(slow, z, rcond=None)[0]
    frequency = np.arange(FEWEST_WAVES_ALONG, highest, 0.5)
    power = signal.lombscargle(u, z, 2 * np.pi * frequency)
    beside = [np.median(power[max(0, i - BESIDE) : i + BESIDE + 1]) for i in range(len(power))]
    ratio = power / np.maximum(np.asarray(beside) / np.log(2), 1e-300)
    k = int(np.argmax(ratio))
    # Twice as many frequencies as are independent.
    chance = min(1.0, 0.6 * len(frequency) * np.exp(-ratio[k]))
    return float(chance), float(2 * power[k] / np.sum(z**2)), span / float(frequency[k])


def ratio_of_branches(T_base: np.ndarray, T_tip: np.ndarray, phases: np.ndarray, bins: int = 14):
    """D and S at matched base tension: half the difference, and half the sum, of ln(T_tip/T_base) on release
    and pull. The first points to friction, the second to gains, offsets and asymmetry.

    Returns:
        Base tension [N], D and S, (n,) each, of the bins in which both branches have samples.
    """
    high = T_base > max(0.03 * float(T_base.max()), 1e-6)
    good = high & (T_tip > 0)
    edges = np.linspace(float(T_base.min()), float(T_base.max()) + 1e-9, bins + 1)
    at, D, S = [], [], []
    for low, top in itertools.pairwise(edges):
        inside = good & (T_base >= low) & (T_base < top)
        rho = {p: np.log(T_tip[inside & (phases == p)] / T_base[inside & (phases == p)]) for p in PHASES}
        if len(rho["pulling"]) and len(rho["releasing"]):
            up, down = float(np.mean(rho["pulling"])), float(np.mean(rho["releasing"]))
            at.append(0.5 * (low + top))
            D.append(0.5 * (down - up))
            S.append(0.5 * (down + up))
    return np.asarray(at), np.asarray(D), np.asarray(S)


def mu_by_stratum(bench: Bench, fitted: Fitted) -> list[tuple[str, float, float]]:
    """Friction coefficient from parts of the samples, the rest as fitted: label, value, standard error."""
    found, number = [], fitted.numbers[0]
    white, columns = bench.by_channel(fitted.rows), bench.by_channel(fitted.jacobian[:, 0])
    for k, rig in enumerate(bench.rigs):
        T = rig.part.T_base.T_base
        phases, cycle = phases_of(bench, fitted, k), cycles_of(T)
        z, j = white[k][0], columns[k][0]
        half = 0.5 * (float(T.max()) + float(T.min()))
        parts = {p: phases == p for p in ("pulling", "releasing")}
        parts |= {"below half the tension": T < half, "above half the tension": T >= half}
        if cycle[-1] > 1:
            parts |= {f"cycle {c}": cycle == c for c in range(1, int(cycle[-1]) + 1)}
        for label, inside in parts.items():
            power = float(np.sum(j[inside] ** 2))
            if inside.sum() < 6 or power < 1.0:
                continue
            x = fitted.x[0] - float(j[inside] @ z[inside]) / power
            found.append((label, number.value(x), number.value(fitted.x[0]) * number.sd / np.sqrt(power)))
    return found
