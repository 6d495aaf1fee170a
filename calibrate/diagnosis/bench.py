"""All recordings on the bench: residuals made white, and hypotheses refitted to them."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from gtr_jax.robot.parameters import parameters_of

from ..base_tension import exact
from ..coordinates import CHANNELS
from ..noise import MAD_TO_SD, resolution
from ..weighing import Weighing
from .hypotheses import Hypothesis, Number
from .rig import Rig, Seen

# Steps of differences, in coordinates, and of the descent.
STEP, LARGEST_STEP = 0.02, 1.5
MOST_ITERATIONS, TRIES, SETTLED = 14, 6, 0.05
# A simulation that fails counts as this many variances per sample.
FAILED = 1e3
# Differences beyond so many standard deviations are jumps.
TRIMMED = 3.5
# Correlation of neighbouring readings that is expected, and how many samples that expectation counts for.
# Taken as zero below 120 samples, the variance of slow noise came out at half its size in the median over 190
# recordings of the blind benchmark (0.07 of it in one of fifty); with this within 10 % (0.3).
USUAL_RHO, SAID = 0.25, 60
# Error that simulations keep once corrected to a fine mesh, as a share of a channel's range.
DISCRETE = 1e-4


@dataclasses.dataclass(frozen=True)
class Noise:
    """Error of one channel as an AR(1) process.

    Attributes:
        sd: standard deviation of noise and of what the mesh leaves out.
        rho: correlation between neighbours.
        mesh: standard deviation of the latter alone.
    """

    sd: float
    rho: float
    mesh: float = 0.0

    @property
    def cell(self) -> float:
        """Standard deviation of the noise alone."""
        return float(np.sqrt(max(self.sd**2 - self.mesh**2, 0.0)))


def _spread(x: np.ndarray) -> float:
    """Standard deviation without what lies far off."""
    rough = MAD_TO_SD * float(np.median(np.abs(x)))
    inside = np.abs(x) < TRIMMED * rough
    return float(np.sqrt(np.mean(x[inside] ** 2))) if inside.any() else rough


def noise_of(residual: np.ndarray, least: float) -> Noise:
    """Noise from the differences of a residual between samples one and two apart.

    A misfit varies slowly from sample to sample and hardly enters; where it jumps is left out. Few samples
    say little of how far neighbours hang together, so that what they say is drawn towards `USUAL_RHO`.
    """
    near, far = (_spread(residual[k:] - residual[:-k]) for k in (1, 2))
    if near <= 0 or len(residual) < 16:
        return Noise(max(float(near) / np.sqrt(2), least), 0.0)
    K = len(residual)
    rho = float(np.clip((K * ((far / near) ** 2 - 1) + SAID * USUAL_RHO) / (K + SAID), 0.0, 0.8))
    return Noise(max(float(near) / np.sqrt(2 * (1 - rho)), least), rho)


def noise_in(rig: Rig, residual: np.ndarray) -> list[Noise]:
    """Noise of the channels of a recording, and what is left of discretisation, which counts as such."""
    part = rig.part
    least = np.maximum(part.smallest, [resolution(row) / np.sqrt(12) for row in part.recorded])
    noise = [noise_of(row, low) for row, low in zip(residual, least, strict=True)]
    if part.noise_N is not None:
        noise[0] = Noise(part.noise_N, noise[0].rho)
    size = [float(np.max(np.abs(part.T_base.T_base))), *np.ptp(part.recorded[1:], axis=1)]
    return [
        Noise(float(np.hypot(n.sd, DISCRETE * s)), n.rho, DISCRETE * s)
        for n, s in zip(noise, size, strict=True)
    ]


def passing(rig: Rig, seen: Seen, noise: list[Noise], values: Mapping[str, float]) -> Weighing:
    """How a recording's residuals weigh, the noise of the base tension passed on."""
    part, K = rig.part, rig.part.samples
    sd, base = np.asarray([n.sd for n in noise]), part.T_base
    plain = Weighing.plain(exact(base.T_base) if base.sd == 0 else base, part.channels, sd)
    step = 1e-3 * max(float(np.ptp(base.T_base)), 1e-3)
    plainly, raised = rig(values), rig(values, step)
    if base.sd == 0 or raised is None or plainly is None:
        return plain
    slipped = np.maximum.accumulate(np.where(seen.slips, np.arange(K), 0))
    last = [slipped if name == "T_tip" else np.arange(K) for name in part.channels]
    slope = ((raised.values - plainly.values) / step)[part.where]
    far = 50 * np.median(np.abs(slope), axis=1, keepdims=True) + 1e-12
    slope = np.where(np.abs(slope) < far, slope, 0.0)
    return dataclasses.replace(plain, slope=slope, last=np.stack(last), sd_base=base.believed)


class Dimension(NamedTuple):
    """A number of the robot file that is uncertain: name, unit, value and standard deviation, SI."""

    name: str
    unit: str
    value: float
    sd: float


class Follow(NamedTuple):
    """How the recordings answer to the uncertain dimensions, each moved by its standard deviation.

    Attributes:
        change: of the channels of each recording, (C, K, D) each.
        left, sizes, right: of the white rows, (n, D), by singular values: (n, m), (m,), (m, D).
    """

    change: list[np.ndarray]
    left: np.ndarray
    sizes: np.ndarray
    right: np.ndarray

    def freed(self, rows: np.ndarray) -> np.ndarray:
        """Rows of unit variance, (n, ...), once the dimensions are allowed to follow."""
        shares = 1 - 1 / np.sqrt(1 + self.sizes**2)
        return rows - (self.left * shares) @ (self.left.T @ rows)

    def moved(self, freed: np.ndarray) -> np.ndarray:
        """By how many standard deviations they then do, (D,)."""
        return -self.right.T @ (self.sizes / np.sqrt(1 + self.sizes**2) * (self.left.T @ freed))


class Model(NamedTuple):
    """What acts: names of hypotheses, the free numbers, mu and E first, and those that are set."""

    names: tuple[str, ...]
    numbers: tuple[Number, ...]
    fixed: Mapping[str, float]

    def values(self, x: np.ndarray) -> dict[str, float]:
        """Values at coordinates, SI, by name."""
        return dict(self.fixed) | {n.name: n.value(v) for n, v in zip(self.numbers, x, strict=True)}


def model_of(base: tuple[Number, ...], hypotheses: Sequence[Hypothesis]) -> Model:
    """The base numbers, and those of some hypotheses."""
    fixed = {name: value for h in hypotheses for name, value in h.fixed.items()}
    numbers = (*base, *(n for h in hypotheses for n in h.numbers))
    return Model(tuple(h.name for h in hypotheses), numbers, fixed)


class Point(NamedTuple):
    """A model at coordinates: values by name [SI], simulations, and white residuals (n,)."""

    values: Mapping[str, float]
    seen: tuple[Seen, ...]
    rows: np.ndarray

    @property
    def failed(self) -> int:
        """Load steps that did not converge."""
        return sum(s.failed for s in self.seen)


@dataclasses.dataclass(frozen=True, eq=False)
class Fitted:
    """A set of hypotheses refitted.

    Attributes:
        names: of the hypotheses; none for the base model.
        numbers: free ones, mu and E first.
        x: their coordinates.
        values: the same and the fixed ones, SI, by name.
        rows: white residuals at the solution.
        jacobian: of the rows by x.
        chi2: sum of squares of the rows.
        prior: sum of squares of the coordinates under their priors.
        seen: the simulations, the uncertain dimensions moved as fits best.
        failed: steps that did not converge.
        dimensions: their values [SI], by name.
    """

    names: tuple[str, ...]
    numbers: tuple[Number, ...]
    x: np.ndarray
    values: Mapping[str, float]
    rows: np.ndarray
    jacobian: np.ndarray
    chi2: float
    prior: float
    seen: tuple[Seen, ...]
    failed: int
    dimensions: Mapping[str, float]

    @property
    def cost(self) -> float:
        """What is minimised; load steps that failed count against it."""
        return self.chi2 + self.prior + FAILED * self.failed

    def volume(self) -> float:
        """Log of the share of the prior that the data leave, by Laplace's approximation, and of the prior's
        density there.
        """
        # Half a normal distribution, of a size that cannot be negative, is twice as dense.
        halves = sum(n.size and not n.log and n.bounds[0] > -0.5 for n in self.numbers)
        logdet = np.linalg.slogdet(self.information())[1]
        return float(-0.5 * self.prior - 0.5 * logdet + halves * np.log(2.0))

    def information(self, scale: float = 1.0) -> np.ndarray:
        """Of data and priors about the coordinates."""
        return self.jacobian.T @ self.jacobian / scale + np.eye(len(self.x))


class Bench:
    """Recordings with their residuals made white.

    Args:
        rigs: the recordings.
        base: numbers fitted whatever the hypothesis.
        dimensions: numbers that follow a little, to first order.
    """

    def __init__(self, rigs: Sequence[Rig], base: tuple[Number, ...], dimensions: Sequence[Dimension] = ()):
        self.rigs, self.base, self.dimensions = tuple(rigs), base, tuple(dimensions)
        self.follow: Follow | None = None
        self.noise: list[list[Noise]] = []
        self.weighs: list[Weighing] = []
        # What a fine mesh shows more than the coarse one, of each recording, by the effects that act.
        self.corrections: dict[tuple[str, ...], list[np.ndarray]] = {
            (): [np.zeros((len(CHANNELS), r.part.samples)) for r in self.rigs]
        }

    def simulate(self, values: Mapping[str, float], names: Sequence[str] = ()) -> tuple[Seen, ...] | None:
        """All recordings with some numbers changed; None where one breaks down.

        Args:
            values: SI, by name.
            names: of the hypotheses that act, for the correction to a fine mesh.
        """
        found = []
        for rig, more in zip(self.rigs, self.correction(names), strict=True):
            seen = rig(values)
            if seen is None:
                return None
            found.append(dataclasses.replace(seen, values=seen.values + more))
        return tuple(found)

    def correction(self, names: Sequence[str]) -> list[np.ndarray]:
        """What a fine mesh shows more where some hypotheses act: as computed, or the sum of each one's."""
        key, plain = tuple(sorted(names)), self.corrections[()]
        if key in self.corrections:
            return self.corrections[key]
        of = [self.corrections[(name,)] for name in key if (name,) in self.corrections]
        return [p + sum((c[k] - p for c in of), np.zeros_like(p)) for k, p in enumerate(plain)]

    def residuals(self, seen: Sequence[Seen]) -> list[np.ndarray]:
        """Simulated minus recorded of each recording, (C, K)."""
        return [s.values[rig.part.where] - rig.part.recorded for rig, s in zip(self.rigs, seen, strict=True)]

    def weigh(
        self, values: Mapping[str, float], seen: Sequence[Seen], known: Sequence[list[Noise]] | None = None
    ) -> None:
        """Take noise, and how it passes from the base to the tip, from a fit.

        Args:
            values, seen: SI, by name, and what was simulated with them.
            known: noise of the channels of each recording; estimated unless given.
        """
        self.noise = [noise_in(*of) for of in zip(self.rigs, self.residuals(seen), strict=True)]
        if known is not None:
            self.noise = list(known)
        self.weighs = [passing(*of, values) for of in zip(self.rigs, seen, self.noise, strict=True)]
        self.answer_of_dimensions(values)

    def answer_of_dimensions(self, values: Mapping[str, float]) -> None:
        """Find how the dimensions change what is simulated at some values."""

        def change(rig: Rig, d: Dimension, here: Seen | None) -> np.ndarray:
            there = rig(dict(values) | {d.name: d.value + d.sd})
            shape = rig.part.recorded.shape
            return (
                np.zeros(shape)
                if here is None or there is None
                else (there.values - here.values)[rig.part.where]
            )

        if not self.dimensions:
            return
        by_rig = []
        for rig in self.rigs:
            here = rig(values)
            by_rig.append(np.stack([change(rig, d, here) for d in self.dimensions], axis=-1))
        self.follow = self.following(by_rig)

    def following(self, change: list[np.ndarray]) -> Follow:
        """How the white rows answer to dimensions that change the channels."""
        white = [self.white([c[..., k] for c in change]) for k in range(len(self.dimensions))]
        return Follow(change, *np.linalg.svd(np.stack(white, axis=1), full_matrices=False))

    def expected_rms(self, *, mesh: bool = True) -> float:
        """What the residual of T_tip should be if nothing but noise is left in it, and, where wanted, what
        the mesh leaves out [N].
        """
        total, count = 0.0, 0
        for rig, noise, weigh in zip(self.rigs, self.noise, self.weighs, strict=True):
            # Of the base cell's noise only what its straight runs leave stays.
            passed = weigh.passed[0] ** 2 * rig.part.T_base.size / rig.part.samples
            own = noise[0].sd if mesh else noise[0].cell
            total += rig.part.samples * own**2 + float(np.sum(passed))
            count += rig.part.samples
        return float(np.sqrt(total / count))

    def rows(self, seen: Sequence[Seen]) -> np.ndarray:
        """White residuals of all recordings in one, the uncertain dimensions free to follow, (n,)."""
        rows = self.white(self.residuals(seen))
        return rows if self.follow is None else self.follow.freed(rows)

    def white(self, residuals: Sequence[np.ndarray]) -> np.ndarray:
        """Rows of residuals, (C, K) each, with nothing free to follow."""
        return np.concatenate([self.white_of(k, residual) for k, residual in enumerate(residuals)])

    def white_of(self, k: int, residual: np.ndarray) -> np.ndarray:
        """The same of recording k alone."""
        found = []
        channels, base = self.weighs[k].split(residual)
        for row, n in zip(channels, self.noise[k], strict=True):
            found.append(np.concatenate([row[:1], (row[1:] - n.rho * row[:-1]) / np.sqrt(1 - n.rho**2)]))
        return np.concatenate([*found, base])

    def at(self, model: Model, x: np.ndarray) -> Point | None:
        """A model at coordinates; None where the simulation breaks down."""
        values = model.values(x)
        seen = self.simulate(values, model.names)
        return None if seen is None else Point(values, seen, self.rows(seen))

    def slopes(
        self, model: Model, x: np.ndarray, rows: np.ndarray, known: Mapping[int, np.ndarray] | None = None
    ) -> np.ndarray:
        """Derivatives of the rows by differences, over steps that cross the kinks of friction; but for those
        known, by place.
        """
        columns = []
        for i, n in enumerate(model.numbers):
            if known is not None and i in known:
                columns.append(known[i])
                continue
            step = STEP if x[i] + STEP <= n.bounds[1] else -STEP
            moved = np.array(x)
            moved[i] += step
            there = self.at(model, moved)
            columns.append(np.zeros_like(rows) if there is None else (there.rows - rows) / step)
        return np.stack(columns, axis=1)

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
            exact: whether the Jacobian is taken anew at the end.
        """
        model = model_of(self.base, hypotheses)
        numbers = model.numbers
        low, high = (np.asarray([n.bounds[k] for n in numbers]) for k in (0, 1))
        x = np.clip(start, low, high)
        here = self.at(model, x)
        if here is None:
            return None

        def cost(point: Point, x: np.ndarray) -> float:
            return float(np.sum(point.rows**2) + firm * np.sum(x**2) + FAILED * point.failed)

        best, damping, fresh = cost(here, x), 1e-3, False
        for _ in range(most):
            if jacobian is None:
                jacobian, fresh = self.slopes(model, x, here.rows, known), known is None
                known = None
            gradient = jacobian.T @ here.rows + firm * x
            hessian = jacobian.T @ jacobian + firm * np.eye(len(x))
            free = ~(((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0)))
            if not free.any():
                break
            A = hessian[np.ix_(free, free)]
            gained, promised = 0.0, 0.0
            for _ in range(TRIES):
                step = np.zeros(len(x))
                step[free] = -np.linalg.solve(A + damping * np.diag(np.diag(A)), gradient[free])
                shorter = min(1.0, LARGEST_STEP / max(float(np.max(np.abs(step))), 1e-300))
                trial = np.clip(x + shorter * step, low, high)
                moved = trial - x
                promised = float(-2 * gradient @ moved - moved @ hessian @ moved)
                if promised < SETTLED:
                    break
                there = self.at(model, trial)
                new = np.inf if there is None else cost(there, trial)
                if there is not None and new < best:
                    gained, best = best - new, new
                    change = there.rows - here.rows - jacobian @ moved
                    jacobian = jacobian + np.outer(change, moved) / max(float(moved @ moved), 1e-300)
                    x, here = trial, there
                    damping = max(damping / 10, 1e-6)
                    break
                damping = min(damping * 10, 1e6)
                if not fresh:
                    break
            if gained < 0.25 * promised or gained < SETTLED:
                if fresh and gained < SETTLED:
                    break
                jacobian = None
            fresh = False
        if jacobian is None or (exact and not fresh):
            jacobian = self.slopes(model, x, here.rows)
        seen, dimensions = here.seen, {}
        if self.follow is not None:
            moved = self.follow.moved(here.rows)
            seen = tuple(
                s.plus(rig.part.where, c @ moved)
                for s, rig, c in zip(seen, self.rigs, self.follow.change, strict=True)
            )
            dimensions = {
                d.name: d.value + d.sd * float(m) for d, m in zip(self.dimensions, moved, strict=True)
            }
        return Fitted(
            model.names,
            numbers,
            x,
            here.values,
            here.rows,
            jacobian,
            float(np.sum(here.rows**2)),
            float(np.sum(x**2)),
            seen,
            here.failed,
            dimensions,
        )

    def by_channel(self, rows: np.ndarray) -> list[np.ndarray]:
        """White rows, (n, ...), by recording and channel, (C, K, ...) each, without those of the base
        tension.
        """
        found, start = [], 0
        for rig in self.rigs:
            C, K = len(rig.part.channels), rig.part.samples
            found.append(rows[start : start + C * K].reshape(C, K, *rows.shape[1:]))
            start += (C + 1) * K
        return found

    def without(self, held: Sequence[np.ndarray]) -> Bench:
        """The same with samples of each recording, (K,) bool each, left out of everything."""
        other = copy.copy(self)
        other.weighs = [weigh.only(~out) for weigh, out in zip(self.weighs, held, strict=True)]
        if self.follow is not None:
            other.follow = other.following(self.follow.change)
        return other

    def with_dimensions_free(self) -> Bench:
        """The same recordings with the uncertain dimensions among the base numbers: their derivatives are too
        rough for values and errors.
        """
        other, known, numbers = copy.copy(self), parameters_of(self.rigs[0].robot), []
        for d in self.dimensions:
            low, high = known[d.name].lower, known[d.name].upper
            lower, upper = (-np.inf if low is None else low), (np.inf if high is None else high)
            numbers.append(Number(d.name, d.unit, d.value, d.sd, False, lower, upper))
        other.base, other.dimensions, other.follow = (*self.base, *numbers), (), None
        return other

    @property
    def readings(self) -> int:
        """Number of readings of all channels."""
        return sum(len(rig.part.channels) * rig.part.samples for rig in self.rigs)

    def mean_square(self, fitted: Fitted) -> float:
        """Of the white residuals of the channels, per degree of freedom."""
        total = sum(float(np.sum(z**2)) for z in self.by_channel(fitted.rows))
        return total / max(self.readings - len(fitted.x), 1)
