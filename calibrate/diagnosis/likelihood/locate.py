"""Where a simulation and a recording differ: by phase, tension, cycle, rate and channel."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np

from calibrate.diagnosis.hypotheses.hypotheses import is_friction
from calibrate.diagnosis.hypotheses.model import Fitted
from calibrate.inference.channels import quantity_of, unit_of
from calibrate.inference.instruments import leading, of_one, tendon_of_channel
from calibrate.inference.number import OWN
from calibrate.inference.setup import Observation
from gtr_jax.recordings.base_tension import turning_points
from gtr_jax.simulation.phases import PULLING, RELEASING, TRANSITION, phases_of_slip

from .likelihood import Likelihood

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
        phase: "pulling", "transition" or "releasing", or "" for all; of the channel's own tendon, or of that
            which leads.
        T_base_N: range of the base tension of that tendon [N]; None where displacement drives it.
        cycle: number of the cycle, from 1; None for all.
        mean, excess_rms: simulated minus recorded, and its size beyond the noise, in `unit`.
        unit: N, m or rad.
        z: significance of the mean, in standard errors.
        share: of the misfit of this channel.
        says: the same in words.
        tendon: its name, where there are several.
        displacement_m: range of the displacement that drives the tendon [m]; None where tension does.
    """

    recording: str
    channel: str
    phase: str
    T_base_N: tuple[float, float] | None
    cycle: int | None
    mean: float
    excess_rms: float
    unit: str
    z: float
    share: float
    says: str
    tendon: str = ""
    displacement_m: tuple[float, float] | None = None

    def to_json(self) -> dict[str, Any]:
        """For `diagnosis.json`: without what only robots of several tendons, or displacement, give."""
        more = {"tendon": self.tendon or None, "displacement_m": self.displacement_m}
        given = {k: v for k, v in dataclasses.asdict(self).items() if k not in more}
        return given | {k: v for k, v in more.items() if v is not None}


def phases_of(likelihood: Likelihood, fitted: Fitted, k: int) -> np.ndarray:
    """Phase of each sample of recording k under a fit, (K, *tendons) of str."""
    seen = fitted.seen[k]
    if seen.slips.ndim == 1:
        return phases_of_slip(seen.slips, seen.direction, first=PULLING)
    each = (phases_of_slip(*of, first=PULLING) for of in zip(seen.slips.T, seen.direction.T, strict=True))
    return np.stack(list(each), axis=1)


def cycles_in(part: Observation) -> np.ndarray:
    """Number of the cycle of each sample of a recording, from 1, by the tendon that leads, (K,)."""
    return cycles_of(part.drives[leading(part)].T_base)


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


def locate(likelihood: Likelihood, fitted: Fitted) -> list[Where]:
    """The parts in which a fit and the recordings differ by more than noise, those with most of the misfit
    first.
    """
    found: list[tuple[Where, bool, float]] = []
    for k, (rig, residual) in enumerate(zip(likelihood.rigs, likelihood.residuals(fitted.seen), strict=True)):
        part = rig.part
        phases, cycle = phases_of(likelihood, fitted, k), cycles_in(part)
        for c, (name, row) in enumerate(zip(part.channels, residual, strict=True)):
            noise = likelihood.noise[k][c]
            tendon = tendon_of_channel(part, name)
            T, by_draw = part.drives[tendon].T_base, part.robot.tendons[tendon].drive == "displacement"
            off = row - row.mean() if quantity_of(name) == "displacement" else row
            # Samples per independent one; and variance with the base tension's noise, which passes on where
            # the tip slips.
            tau = (1 + noise.rho) / (1 - noise.rho)
            variance = noise.sd**2 + likelihood.weighs[k].passed[c] ** 2
            total = float(np.sum(np.maximum(off**2 - variance, 0.0)[part.counted]))
            for phase, number, stratum in _strata(T, of_one(phases, tendon), cycle):
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
                whose = part.robot.tendon_names[tendon] if part.others else ""
                place = Where(
                    recording=part.name,
                    channel=name,
                    phase=phase,
                    T_base_N=None if by_draw else reach,
                    cycle=number,
                    mean=mean,
                    excess_rms=excess,
                    unit=unit_of(name),
                    z=float(z),
                    share=share,
                    says=("" if len(likelihood.rigs) == 1 else f"{part.name}: ")
                    + _words(
                        (name, unit_of(name)),
                        phase,
                        number,
                        _reach(reach, whose, by_draw=by_draw),
                        mean,
                        excess,
                    ),
                    tendon=whose,
                    displacement_m=reach if by_draw else None,
                )
                # Channels of one unit are compared by what they miss in variances of their noise.
                size = share if part.tips else n * excess**2 / expected
                found.append((place, c < part.explained, size))
    by_tension = sorted((f for f in found if f[0].cycle is None), key=lambda f: (not f[1], -f[2]))
    by_cycle = sorted((f for f in found if f[0].cycle is not None and f[1]), key=lambda f: -f[2])
    return [place for place, *_ in (*by_tension[:MOST], *by_cycle[: MOST // 2])]


def _reach(reach: tuple[float, float], tendon: str, *, by_draw: bool) -> str:
    """A range of what drives a tendon, in words."""
    of = f" of {tendon}" if tendon else ""
    if by_draw:
        return f"{1e3 * reach[0]:.3g} to {1e3 * reach[1]:.3g} mm drawn out{of}"
    return f"{reach[0]:.3g} to {reach[1]:.3g} N at the base{of}"


def _words(channel: tuple[str, str], phase, cycle, reach, mean, excess) -> str:
    name, unit = channel
    factor, shown = {"N": (1.0, "N"), "m": (1e3, "mm"), "rad": (180 / np.pi, "deg")}[unit]
    sense = "too high" if mean > 0 else "too low"
    where = f"while {phase}" if phase != "transition" else "in the transition"
    which = f", cycle {cycle}" if cycle is not None else ""
    return (
        f"{where}{which}, {reach}: simulated {name} {sense} by "
        f"{abs(mean) * factor:.2g} {shown} in the mean, {excess * factor:.2g} {shown} rms beyond the noise"
    )


def misfit(likelihood: Likelihood, fitted: Fitted) -> tuple[float, float]:
    """How much structure a fit leaves: rms of the white residuals beyond noise, in standard deviations of it,
    and its significance in standard errors.

    The significance is that of sums over neighbouring samples, whose noise is independent after whitening.
    """
    energy, count, blocks, squares = 0.0, 0, 0, 0.0
    for whole, rig in zip(
        likelihood.by_channel(likelihood.unrobustify(fitted.rows)), likelihood.rigs, strict=True
    ):
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


def between_samples(likelihood: Likelihood, fitted: Fitted) -> float:
    """Sum of squares, in variances of the noise, that a delay of the tip's cell may leave because the tension
    between two samples is not known: it may turn there as much as it does from one interval to the next.
    """
    found = []
    for rig, seen in zip(likelihood.rigs, fitted.seen, strict=True):
        part, shown = rig.part, seen.values[rig.where]
        off = np.zeros_like(shown)
        for row in range(part.tips):
            names = part.robot.tendon_names
            own = f".{names[tendon_of_channel(part, part.channels[row])]}" if names else ""
            ends = (
                fitted.values.get(f"time-skew.{name}{own}", fitted.values.get(f"time-skew.{name}", 0.0))
                for name in ("delay", "rate")
            )
            if part.time is not None:
                off[row] = _turning(part.time, shown[row], *ends)
        found.append(off)
    return float(np.sum(likelihood.robustify(likelihood.white(found)) ** 2))


def _turning(time: np.ndarray, T: np.ndarray, delay: float, rate: float) -> np.ndarray:
    """By how much a tension [N] that is read late may differ from one interpolated between samples, (K,)."""
    stamps, first = np.unique(time, return_index=True)
    if len(stamps) < 3:
        return np.zeros_like(T)
    steps = np.diff(stamps)
    turn = np.zeros(len(stamps))
    turn[1:-1] = np.abs(np.diff(np.diff(T[first]) / steps))
    at = time - delay - rate * (time - stamps[0])
    k = np.clip(np.searchsorted(stamps, at, side="right") - 1, 0, len(steps) - 1)
    share = np.clip((at - stamps[k]) / steps[k], 0.0, 1.0)
    return share * (1 - share) * steps[k] * np.maximum(turn[k], turn[k + 1])


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


def _rows_of(part: Observation, tendon: int) -> list[int]:
    """Channels of a recording without tip tension that tell of the friction of a tendon: all but those of
    other tendons.
    """
    several = bool(part.others)
    return [
        c
        for c, name in enumerate(part.channels)
        if not (several and "." in name) or tendon_of_channel(part, name) == tendon
    ]


def mu_by_stratum(
    likelihood: Likelihood, fitted: Fitted, covariance: np.ndarray
) -> list[tuple[str, float, float, float]]:
    """Friction coefficient of the base model from parts of the samples, the rest as fitted.

    Args:
        likelihood: the recordings.
        fitted: the base model; mu of each tendon, or of each recording, is among its numbers.
        covariance: of its coordinates, (p, p): the uncertainty of the other numbers counts in the errors.

    Returns:
        Label, value, standard error, and the standard error from the part's own noise alone, for each part
        that determines mu. The rest is common to all parts, because errors of the other numbers move them
        together.
    """
    found, names = [], [n.name for n in fitted.numbers]
    white, columns = likelihood.by_channel(fitted.rows), likelihood.by_channel(fitted.jacobian)
    wide = max(1.0, likelihood.mean_square(fitted))
    friction = list(dict.fromkeys(n.parameter for n in fitted.numbers if is_friction(n)))
    for k, rig in enumerate(likelihood.rigs):
        phases, cycle = phases_of(likelihood, fitted, k), cycles_in(rig.part)
        for i, mu_name in enumerate(friction):
            own = f"{mu_name}{OWN}{rig.part.name}"
            at = names.index(own) if own in names else names.index(mu_name)
            number, others = fitted.numbers[at], np.arange(len(names)) != at
            part, T = rig.part, rig.part.drives[i].T_base
            rows = [i] if part.tips else _rows_of(part, i)
            z, j = white[k][rows], columns[k][rows]
            half = 0.5 * (float(T.max()) + float(T.min()))
            what = "tension" if part.robot.tendons[i].drive == "tension" else "displacement"
            strata = {p: of_one(phases, i) == p for p in ("pulling", "releasing")}
            strata |= {f"below half the {what}": T < half, f"above half the {what}": T >= half}
            if cycle[-1] > 1:
                strata |= {f"cycle {c}": cycle == c for c in range(1, int(cycle[-1]) + 1)}
            for label, stratum in strata.items():
                inside = stratum & part.counted
                slopes = j[:, inside].reshape(-1, len(names))
                mu = slopes[:, at]
                power = float(mu @ mu)
                if inside.sum() < 6 or power < 1.0:
                    continue
                x = fitted.x[at] - float(mu @ z[:, inside].ravel()) / power
                lean = -(mu @ slopes[:, others]) / power
                sd = float(np.sqrt(wide / power + lean @ covariance[np.ix_(others, others)] @ lean))
                whose = f"{part.name}, " if len(likelihood.rigs) > 1 else ""
                whose += f"{part.robot.tendon_names[i]}, " if len(friction) > 1 else ""
                size = number.value(fitted.x[at]) * number.sd
                found.append((whose + label, number.value(x), size * sd, size * float(np.sqrt(wide / power))))
    return found
