"""Where a simulation and a recording differ: by phase, tension, cycle, rate and channel."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from gtr_jax.simulation.phases import PULLING, RELEASING, TRANSITION, phases_of_slip

from ..channels import CHANNEL_UNITS, CHANNELS
from ..number import OWN
from ..readings import turning_points
from .bench import Bench
from .model import Fitted

PHASES = (PULLING, TRANSITION, RELEASING)
# Samples that a part needs; significance, in standard errors, from which it is reported.
FEWEST, SEEN = 4, 3.5
# Single residuals are clipped at this many standard deviations, or at this quantile of all if that is larger.
LONE, RARE = 4.0, 0.98
# Parts reported by range of tension; half as many by cycle.
MOST = 6


@dataclasses.dataclass(frozen=True)
class Where:
    """A part of the recordings in which simulation and recording differ.

    Attributes:
        recording: its name.
        channel: the channel that differs: "T_tip", one of the pose or "displacement".
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
    """Phases by range of tension, and phases by cycle: phase, cycle or None, and samples of each."""
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
            # Samples per independent one; and variance with the base tension's noise, which passes on where
            # the tip slips.
            tau = (1 + noise.rho) / (1 - noise.rho)
            variance = noise.sd**2 + bench.weighs[k].passed[c] ** 2
            total = float(np.sum(np.maximum(off**2 - variance, 0.0)[part.counted]))
            for phase, number, stratum in _strata(T, phases, cycle):
                inside = stratum & part.counted
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
                        recording=part.name,
                        channel=name,
                        phase=phase,
                        T_base_N=reach,
                        cycle=number,
                        mean=mean,
                        excess_rms=excess,
                        unit=unit,
                        z=float(z),
                        share=share,
                        says=("" if len(bench.rigs) == 1 else f"{part.name}: ")
                        + _words(name, phase, reach, number, mean, excess, unit),
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

    The significance is that of sums over neighbouring samples, whose noise is independent after whitening.
    """
    energy, count, blocks, squares = 0.0, 0, 0, 0.0
    for whole, rig in zip(bench.by_channel(bench.untamed(fitted.rows)), bench.rigs, strict=True):
        z = whole[:, rig.part.counted]
        C, K = z.shape
        if not K:
            continue
        length = int(np.clip(K // 12, 3, 10))
        n = K // length
        sums = z[:, : n * length].reshape(C, n, length).sum(axis=2) / np.sqrt(length)
        limit = max(LONE, float(np.quantile(np.abs(z), RARE)))
        energy, count = energy + float(np.sum(np.clip(z, -limit, limit) ** 2)), count + z.size
        blocks, squares = blocks + sums.size, squares + float(np.sum(sums**2))
    free = len(fitted.x)
    excess = np.sqrt(max(energy / max(count - free, 1) - 1, 0.0))
    return float(excess), float((squares - blocks + min(free, blocks // 2)) / np.sqrt(2 * blocks))


def ratio_of_branches(T_base: np.ndarray, T_tip: np.ndarray, phases: np.ndarray, bins: int = 14):
    """D and S at matched base tension: half the difference, and half the sum, of ln(T_tip/T_base) on release
    and pull. D points to friction, S to gains, offsets and asymmetry.

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


def mu_by_stratum(
    bench: Bench, fitted: Fitted, covariance: np.ndarray
) -> list[tuple[str, float, float, float]]:
    """Friction coefficient of the base model from parts of the samples, the rest as fitted.

    Args:
        bench: the recordings.
        fitted: the base model; mu is its first number, or that of each recording is among its numbers.
        covariance: of its coordinates, (p, p): the uncertainty of the other numbers counts in the errors.

    Returns:
        Label, value, standard error, and the standard error from the part's own noise alone, for each part
        that determines mu. The rest is common to all parts, because errors of the other numbers move them
        together.
    """
    found, names = [], [n.name for n in fitted.numbers]
    white, columns = bench.by_channel(fitted.rows), bench.by_channel(fitted.jacobian)
    wide = max(1.0, bench.mean_square(fitted))
    for k, rig in enumerate(bench.rigs):
        own = f"mu{OWN}{rig.part.name}"
        at = names.index(own) if own in names else 0
        number, others = fitted.numbers[at], np.arange(len(names)) != at
        T = rig.part.T_base.T_base
        phases, cycle = phases_of(bench, fitted, k), cycles_of(T)
        z, j = white[k][0], columns[k][0]
        half = 0.5 * (float(T.max()) + float(T.min()))
        parts = {p: phases == p for p in ("pulling", "releasing")}
        parts |= {"below half the tension": T < half, "above half the tension": T >= half}
        if cycle[-1] > 1:
            parts |= {f"cycle {c}": cycle == c for c in range(1, int(cycle[-1]) + 1)}
        for label, part in parts.items():
            inside = part & rig.part.counted
            mu = j[inside, at]
            power = float(mu @ mu)
            if inside.sum() < 6 or power < 1.0:
                continue
            x = fitted.x[at] - float(mu @ z[inside]) / power
            lean = -(mu @ j[inside][:, others]) / power
            sd = float(np.sqrt(wide / power + lean @ covariance[np.ix_(others, others)] @ lean))
            whose = f"{rig.part.name}, " if len(bench.rigs) > 1 else ""
            size = number.value(fitted.x[at]) * number.sd
            found.append((whose + label, number.value(x), size * sd, size * float(np.sqrt(wide / power))))
    return found
