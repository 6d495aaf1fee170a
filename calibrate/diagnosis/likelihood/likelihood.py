"""The likelihood: all recordings with whitened residuals, to which hypotheses are refitted."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibrate.diagnosis.hypotheses.hypotheses import Hypothesis
from calibrate.diagnosis.hypotheses.model import Fitted, Model, Point, model_of
from calibrate.inference.channels import quantity_of
from calibrate.inference.instruments import tendon_of_channel
from calibrate.inference.least_squares import BY_DIFFERENCES, Rules, minimise
from calibrate.inference.number import Number
from calibrate.inference.setup import Observation
from calibrate.inference.simulated_readings import SimulatedReadings, simulate_all
from calibrate.inference.simulated_rig import SimulatedRig
from calibrate.inference.weighing import Weighing
from gtr_jax.recordings.signals.noise import (
    MAD_TO_SD,
    Noise,
    correlation_time,
    of_residual,
    resolution,
    whitened,
)

from .follow import Follow

# Step of the finite differences, and largest step of the descent, in coordinates.
STEP, LARGEST_STEP = 0.02, 1.5
# Iterations of a refit; damped steps with one Jacobian; promised drop of the cost below which it ends.
MOST_ITERATIONS, TRIES, SETTLED = 14, 6, 0.05
RULES = Rules(BY_DIFFERENCES, tries=TRIES, longest=LARGEST_STEP, settled=SETTLED, updated=True)
# The number of the instruments that is scanned, from minus to plus one standard deviation of its prior; and
# how far times of events are scanned to each side, in the changes that matter.
SCANNED, TIMES = "time-skew.delay", 13
ASIDE = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 12.0, 16.0, 24.0, 32.0)
# Times what is usual: rows beyond it count only a little more.
HEAVY = 4.0
# Discretisation error that remains after the correction to a fine mesh, as a share of a channel's range.
DISCRETE = 1e-4


def noise_in(rig: SimulatedRig, residual: np.ndarray) -> list[Noise]:
    """Noise of the channels of a recording, with the remaining discretisation error counted as noise."""
    part = rig.part
    least = np.maximum(part.smallest, [resolution(row) / np.sqrt(12) for row in part.recorded])
    noise = [of_residual(row[part.counted], low) for row, low in zip(residual, least, strict=True)]
    n = part.tips
    if part.noise_N is not None:
        noise[:n] = [Noise(part.noise_N, own.rho) for own in noise[:n]]
    tensions = part.pulled or part.recorded[:n]
    largest = max((float(np.max(np.abs(T))) for T in tensions), default=0.0)
    size = [*([largest] * n), *np.ptp(part.recorded[n:], axis=1)]
    return [
        Noise(float(np.hypot(n.sd, DISCRETE * s)), n.rho, DISCRETE * s)
        for n, s in zip(noise, size, strict=True)
    ]


def without_zero(part: Observation, residual: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """The residual of a recording, (C, K), less the mean of displacements, in each stretch of it: where they
    are counted from is not known.

    Args:
        part: the recording.
        residual: of it.
        inside: samples from which the mean is taken, (K,) bool.
    """
    floating = [quantity_of(name) == "displacement" for name in part.channels]
    if not any(floating) or not inside.any():
        return residual
    zero, since = np.zeros(residual.shape), np.zeros(part.samples) if part.since is None else part.since
    for number in np.unique(since):
        own = since == number
        told = own & inside if (own & inside).any() else own
        zero[:, own] = residual[:, told].mean(axis=1, keepdims=True)
    return residual - np.where(np.asarray(floating)[:, None], zero, 0.0)


def passing(
    rig: SimulatedRig, seen: SimulatedReadings, noise: list[Noise], values: Mapping[str, float]
) -> Weighing:
    """The weighing of a recording's residuals, with the noise of what drives the tendons passed on to the
    channels.
    """
    drives = rig.part.drives
    slopes = [None if drive.sd == 0 else change_by(rig, values, i) for i, drive in enumerate(drives)]
    return rig.part.weighing(seen.slips, slopes, np.asarray([n.sd for n in noise]))


def change_by(rig: SimulatedRig, values: Mapping[str, float], tendon: int) -> np.ndarray | None:
    """Change of the channels per change of what drives a tendon, (C, K), by differences; None where the
    simulation breaks down.
    """
    part = rig.part
    drive = part.drives[tendon]
    step = 1e-3 * max(float(np.ptp(drive.T_base)), 1e-3)
    more = tuple(step if i == tendon else 0.0 for i in range(len(part.drives)))
    plainly, raised = rig(values), rig(values, more)
    if raised is None or plainly is None:
        return None
    slope = ((raised.values - plainly.values) / step)[rig.where]
    far = 50 * np.median(np.abs(slope), axis=1, keepdims=True) + 1e-12
    return np.where(np.abs(slope) < far, slope, 0.0)


@dataclasses.dataclass(frozen=True, eq=False)
class Likelihood:
    """Recordings with whitened residuals.

    Attributes:
        rigs: the recordings.
        base: numbers that every hypothesis fits.
        dimensions: uncertain dimensions, which follow every fit to first order.
        noise: of the channels of each recording, once it is weighed.
        weighs: weighing of the residuals of each recording, likewise.
        follow: response of the whitened rows to the dimensions, likewise; None without dimensions.
        corrections: values on a fine mesh minus those on the coarse one, of each recording, by the effects
            that act.
        heavy: in standard deviations: rows much beyond it count only a little more than those at it (see
            `far`); None where all count by their squares.
        untried: names of terms that are not tried.
    """

    rigs: tuple[SimulatedRig, ...]
    base: tuple[Number, ...]
    dimensions: tuple[Number, ...] = ()
    noise: Sequence[list[Noise]] = ()
    weighs: Sequence[Weighing] = ()
    follow: Follow | None = None
    corrections: Mapping[tuple[str, ...], list[np.ndarray]] = dataclasses.field(default_factory=dict)
    heavy: float | None = None
    untried: Sequence[str] = ()

    def simulate(
        self, values: Mapping[str, float], names: Sequence[str] = ()
    ) -> tuple[SimulatedReadings, ...] | None:
        """All recordings with some numbers changed; None where one breaks down.

        Args:
            values: SI, by name.
            names: of the hypotheses that act, for the correction to a fine mesh.
        """
        return self.simulated([values], names)[0]

    def simulated(
        self, many: Sequence[Mapping[str, float]], names: Sequence[str] = ()
    ) -> list[tuple[SimulatedReadings, ...] | None]:
        """As `simulate`, of several sets of numbers side by side."""
        finer = self.correction(names)

        def corrected(each: Sequence[SimulatedReadings]) -> tuple[SimulatedReadings, ...]:
            return tuple(
                dataclasses.replace(seen, values=seen.values + more)
                for seen, more in zip(each, finer, strict=True)
            )

        return [None if each is None else corrected(each) for each in simulate_all(self.rigs, many)]

    def correction(self, names: Sequence[str]) -> list[np.ndarray]:
        """Values on a fine mesh minus those on the coarse one if some hypotheses act: as computed, or the sum
        over the single hypotheses.
        """
        key, known = tuple(sorted(names)), self.corrections
        plain = known.get(()) or [np.zeros((len(rig.channels), rig.part.samples)) for rig in self.rigs]
        if key in known:
            return known[key]
        of = [known[(name,)] for name in key if (name,) in known]
        return [p + sum((c[k] - p for c in of), np.zeros_like(p)) for k, p in enumerate(plain)]

    def corrected(self, more: Mapping[tuple[str, ...], list[np.ndarray]]) -> Likelihood:
        """The same with further corrections, by names of the effects that act."""
        known = dict(self.corrections) | {tuple(sorted(names)): c for names, c in more.items()}
        return dataclasses.replace(self, corrections=known)

    def residuals(self, seen: Sequence[SimulatedReadings]) -> list[np.ndarray]:
        """Simulated minus recorded of each recording, (C, K), but for the unknown zero of displacements."""
        return [
            without_zero(rig.part, s.values[rig.where] - rig.part.recorded, rig.part.counted)
            for rig, s in zip(self.rigs, seen, strict=True)
        ]

    def weighed(
        self,
        values: Mapping[str, float],
        seen: Sequence[SimulatedReadings],
        known: Sequence[list[Noise]] | None = None,
    ) -> Likelihood:
        """A copy with the noise, and how it passes from the base to the tip, taken from a fit.

        Args:
            values, seen: SI, by name, and what was simulated with them.
            known: noise of the channels of each recording; estimated unless given.
        """
        noise = known
        if noise is None:
            noise = [noise_in(*of) for of in zip(self.rigs, self.residuals(seen), strict=True)]
        weighs = [passing(*of, values) for of in zip(self.rigs, seen, noise, strict=True)]
        other = dataclasses.replace(self, noise=list(noise), weighs=weighs)
        other = dataclasses.replace(other, follow=other.answer_of_dimensions(values))
        return other if self.heavy is None else dataclasses.replace(other, heavy=other.far(seen))

    def far(self, seen: Sequence[SimulatedReadings]) -> float:
        """Where rows of a simulation are far off: `HEAVY` times what is usual among those of what is
        explained. A law that is missing is wrong by many standard deviations of the noise wherever it
        applies.
        """
        rows = [
            z[: rig.part.explained, rig.part.counted]
            for z, rig in zip(self.by_channel(self._free(seen)), self.rigs, strict=True)
        ]
        each = np.concatenate([z.ravel() for z in rows])
        return HEAVY * max(1.0, MAD_TO_SD * float(np.median(np.abs(each))))

    def answer_of_dimensions(self, values: Mapping[str, float]) -> Follow | None:
        """How the dimensions change what is simulated at some values; None without dimensions."""

        def change(
            rig: SimulatedRig, here: SimulatedReadings | None, there: SimulatedReadings | None
        ) -> np.ndarray:
            if here is None or there is None:
                return np.zeros(rig.part.recorded.shape)
            return (there.values - here.values)[rig.where]

        if not self.dimensions:
            return None
        asked, by_rig = [values, *(dict(values) | {d.name: d.centre + d.sd} for d in self.dimensions)], []
        for rig in self.rigs:
            here, *there = rig.many(asked)
            by_rig.append(np.stack([change(rig, here, seen) for seen in there], axis=-1))
        return self.following(by_rig)

    def following(self, change: list[np.ndarray]) -> Follow:
        """Response of the whitened rows to dimensions that change the channels."""
        white = [self.white([c[..., k] for c in change]) for k in range(len(self.dimensions))]
        return Follow(change, *np.linalg.svd(np.stack(white, axis=1), full_matrices=False))

    def expected_rms(self, *, mesh: bool = True) -> float:
        """Expected rms residual of what is explained, SI, if only noise is left in it and, with `mesh`, the
        discretisation error.
        """
        total, count = 0.0, 0
        for rig, noise, weigh in zip(self.rigs, self.noise, self.weighs, strict=True):
            for c, name in enumerate(rig.part.channels[: rig.part.explained]):
                drive = rig.part.drives[tendon_of_channel(rig.part, name)]
                # The straight runs average the base cell's noise: their numbers stand for all samples.
                passed = weigh.passed[c] ** 2 * drive.size / rig.part.samples
                own = noise[c].sd if mesh else noise[c].cell
                total += rig.part.samples * own**2 + float(np.sum(passed))
                count += rig.part.samples
        return float(np.sqrt(total / count))

    def rows(self, seen: Sequence[SimulatedReadings]) -> np.ndarray:
        """Whitened residuals of all recordings in one array, with the uncertain dimensions free to follow,
        (n,).
        """
        return self.robustify(self._free(seen))

    def _free(self, seen: Sequence[SimulatedReadings]) -> np.ndarray:
        rows = self.white(self.residuals(seen))
        return rows if self.follow is None else self.follow.freed(rows, self.robustify(rows))

    def robustify(self, rows: np.ndarray) -> np.ndarray:
        """White rows, (n,), so that their squares sum to what is minimised: with `heavy` tails c, the sum of
        c^2 ln(1 + r^2/c^2), which a Student distribution of the errors has (Barron 2019, eq. 12). Long
        recordings hold stretches in which something outside any model acts, and a few samples in steep
        slopes; counted by their squares, these decide every fit.
        """
        if self.heavy is None:
            return rows
        return np.sign(rows) * self.heavy * np.sqrt(np.log1p((rows / self.heavy) ** 2))

    def unrobustify(self, rows: np.ndarray) -> np.ndarray:
        """The inverse of `robustify`."""
        if self.heavy is None:
            return rows
        return np.sign(rows) * self.heavy * np.sqrt(np.expm1((rows / self.heavy) ** 2))

    def white(self, residuals: Sequence[np.ndarray]) -> np.ndarray:
        """Whitened rows of residuals, (C, K) each, with the dimensions fixed."""
        return np.concatenate([self.white_of(k, residual) for k, residual in enumerate(residuals)])

    def white_of(self, k: int, residual: np.ndarray) -> np.ndarray:
        """Whitened rows of recording k alone."""
        found = []
        channels, base = self.weighs[k].split(residual)
        for row, n in zip(channels, self.noise[k], strict=True):
            found.append(whitened(row, n.rho))
        return np.concatenate([*found, base])

    def at(self, model: Model, x: np.ndarray) -> Point | None:
        """A model at coordinates; None where the simulation breaks down."""
        return self.points(model, [x])[0]

    def points(self, model: Model, many: Sequence[np.ndarray]) -> list[Point | None]:
        """A model at several coordinates, simulated side by side."""
        values = [model.values(x) for x in many]
        return [
            None if seen is None else Point(v, seen, self.rows(seen))
            for v, seen in zip(values, self.simulated(values, model.names), strict=True)
        ]

    def scanned(self, model: Model, x: np.ndarray) -> np.ndarray:
        """Coordinates with the number in `SCANNED`, and then each time of an event, where the cost is least
        while the others stay: the cost has a minimum beside each steep slope that another sample would meet.
        As they are, where none is free.
        """
        for i, n in enumerate(model.numbers):
            if n.name == SCANNED and n in self.base:
                places = np.linspace(-1, 1, TIMES)
            elif n.apart is not None:
                places = x[i] + np.asarray([sign * a for a in ASIDE for sign in (-1, 1)]) * n.apart / n.sd
            else:
                continue
            tries = [np.array(x) for _ in range(len(places) + 1)]
            for one, to in zip(tries[1:], places, strict=True):
                one[i] = np.clip(to, *n.bounds)
            costs = self.squares(model, tries)
            x = tries[int(np.argmin([c + float(np.sum(t**2)) for c, t in zip(costs, tries, strict=True)]))]
        return x

    def squares(self, model: Model, many: Sequence[np.ndarray]) -> list[float]:
        """Sum of squares of the rows of a model at several coordinates; infinite where the simulation breaks
        down.
        """
        return [
            np.inf if here is None else float(np.sum(here.rows**2)) + here.penalty
            for here in self.points(model, many)
        ]

    def slopes(
        self, model: Model, x: np.ndarray, rows: np.ndarray, known: Mapping[int, np.ndarray] | None = None
    ) -> np.ndarray:
        """Derivatives of the rows by finite differences, with steps that cross the kinks of friction; `known`
        columns, by index, are not recomputed.
        """
        columns, steps, moved = dict(known or {}), dict[int, float](), list[np.ndarray]()
        for i, n in enumerate(model.numbers):
            if i in columns:
                continue
            size = STEP if n.apart is None else n.apart / n.sd
            steps[i] = size if x[i] + size <= n.bounds[1] else -size
            moved.append(np.array(x))
            moved[-1][i] += steps[i]
        for (i, step), there in zip(steps.items(), self.points(model, moved), strict=True):
            columns[i] = np.zeros_like(rows) if there is None else (there.rows - rows) / step
        return np.stack([columns[i] for i in range(len(model.numbers))], axis=1)

    def refit(
        self,
        hypotheses: Sequence[Hypothesis],
        start: np.ndarray,
        *,
        jacobian: np.ndarray | None = None,
        known: Mapping[int, np.ndarray] | None = None,
        firm: float = 1.0,
        most: int = MOST_ITERATIONS,
        exact: bool = True,
    ) -> Fitted | None:
        """Refit the base numbers and those of some hypotheses from a start: Levenberg-Marquardt, its Jacobian
        by differences, kept up to date by Broyden's formula while that serves.

        Args:
            hypotheses: those that act.
            start: coordinates, base numbers first.
            jacobian: at the start, if known.
            known: some of its columns, roughly.
            firm: weight of the priors against the rows.
            most: iterations.
            exact: whether the Jacobian is recomputed at the end.
        """
        model = model_of(self.base, hypotheses)
        low, high = model.bounds
        start = np.clip(start, low, high)
        first = self.at(model, start)
        if first is None:
            return None
        if jacobian is None and known is not None:
            jacobian = self.slopes(model, start, first.rows, known)
        end = minimise(
            lambda x: self.at(model, x),
            lambda x, point: self.slopes(model, x, point.rows),
            start,
            first,
            rules=RULES,
            most=most,
            bounds=(low, high),
            weight=firm,
            jacobian=jacobian,
        )
        x, here, jacobian = end.x, end.point, end.jacobian
        if jacobian is None or (exact and not end.fresh):
            jacobian = self.slopes(model, x, here.rows)
        seen, dimensions = here.seen, {}
        if self.follow is not None:
            moved = self.follow.moved(here.rows)
            seen = tuple(
                s.plus(rig.where, c @ moved)
                for s, rig, c in zip(seen, self.rigs, self.follow.change, strict=True)
            )
            dimensions = {
                d.name: d.centre + d.sd * float(m) for d, m in zip(self.dimensions, moved, strict=True)
            }
        return Fitted(
            names=model.names,
            numbers=model.numbers,
            x=x,
            values=here.values,
            rows=here.rows,
            jacobian=jacobian,
            chi2=float(np.sum(here.rows**2)),
            prior=float(np.sum(x**2)),
            seen=seen,
            failed=here.failed,
            dimensions=dimensions,
        )

    def by_channel(self, rows: np.ndarray) -> list[np.ndarray]:
        """White rows, (n, ...), by recording and channel, (C, K, ...) each, without those of the base
        tension.
        """
        found, start = [], 0
        for rig in self.rigs:
            C, K = len(rig.part.channels), rig.part.samples
            found.append(rows[start : start + C * K].reshape(C, K, *rows.shape[1:]))
            start += (C + len(rig.part.drives)) * K
        return found

    def without(self, held: Sequence[np.ndarray]) -> Likelihood:
        """The same with samples of each recording, (K,) bool each, left out of everything."""
        weighs = [weigh.only(~out) for weigh, out in zip(self.weighs, held, strict=True)]
        other = dataclasses.replace(self, weighs=weighs)
        if self.follow is None:
            return other
        return dataclasses.replace(other, follow=other.following(self.follow.change))

    def with_base(self, base: Sequence[Number]) -> Likelihood:
        """The same with other base numbers."""
        return dataclasses.replace(self, base=tuple(base))

    def with_dimensions_free(self) -> Likelihood:
        """The same recordings with the uncertain dimensions among the base numbers: following to first order
        is too rough for values and standard errors.
        """
        return dataclasses.replace(self, base=(*self.base, *self.dimensions), dimensions=(), follow=None)

    @property
    def log_determinant(self) -> float:
        """Of the covariance of all rows, up to a constant, as weighed now."""
        return sum(weigh.log_determinant for weigh in self.weighs)

    @property
    def readings(self) -> int:
        """Number of readings of all channels that are compared."""
        return sum(len(rig.part.channels) * int(rig.part.counted.sum()) for rig in self.rigs)

    def scale_left(self, fitted: Fitted) -> float:
        """Variance of white residuals if all that a fit leaves counts as an error of unknown cause: its mean
        square, times the samples per independent one; at least 1.
        """
        slow = max(correlation_time(row) for z in self.by_channel(fitted.rows) for row in z)
        return max(1.0, self.mean_square(fitted) * slow)

    def mean_square(self, fitted: Fitted) -> float:
        """Mean square of the whitened residuals of the channels, per degree of freedom."""
        total = sum(float(np.sum(z**2)) for z in self.by_channel(fitted.rows))
        return total / max(self.readings - len(fitted.x), 1)
