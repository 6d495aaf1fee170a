"""What is fitted to what: robots, their free parameters and priors, and recordings."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np

from gtr_jax import InputError, Recording, Robot, RobotConfig
from gtr_jax.simulation.history import padded_length
from gtr_jax.terms import REGISTRY, known_on

from .coordinates import Coordinates, coordinates, places
from .descent import Objective
from .free import Free
from .number import Number, number_at
from .predictor import CHANNELS, Prediction, Predictor
from .readings import BaseTension, exact, noise
from .weighing import Weighing

# Range searched: this factor up and down for a positive parameter; this many scales to each side for others.
LARGEST_FACTOR = 30.0
LARGEST_SHIFT = 2.0
# Least error of a channel, as a share of its size; and its error in the search for a start, as a share of its
# range.
SMALLEST_SIGMA, ROUGH = 1e-6, 0.02
STRETCH = "tendon-stretch"
# Recordings with more samples than LONG are simulated at about LONG of them, or, if that is fewer, at steps
# of the base tension of FINEST of its range.
LONG, FINEST = 2000, 1 / 400
# Steps up to which a thinned recording is simulated by the program of the whole one: to simulate held steps
# takes 0.03 ms each, to trace and read another program 1.5 s, and to compile it 8 s.
SHARED = 1024
# A tip angle beyond so many turns, or a tip farther away than so many lengths, must be in another unit.
MOST_TURNS, MOST_LENGTHS = 2.0, 2.0
# A base tension that would strain the outermost fibre by so much, on average and without friction, must be in
# another unit. The shared and shipped recordings reach 0.07 to 0.13, and 102 times that if their newtons are
# grams-force. OFTEN is the percentile of the base tension that is checked, so that lone spikes do not count.
MOST_STRAIN, OFTEN = 2.0, 99.0


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """One recording of K samples as it is fitted.

    Attributes:
        name, path: of the recording.
        robot: with the values it starts from.
        config: its file, or None.
        T_base: estimate of the true base tension, and how well the recorded one determines it.
        channels: names of what is fitted to, T_tip first.
        recorded: their readings, SI, (C, K).
        time: of the samples [s], (K,), or None.
        trial: number of the trial, (K,), or None.
        noise_N: standard deviation of T_tip [N] if given.
        stretches: whether the tendon's stretch is a number of the fit.
        left_out: samples that are simulated and not compared, (K,) bool, or None.
        origin: places of the samples in the recording, (K,), or None for all of them in order.
    """

    name: str
    path: str
    robot: Robot
    config: RobotConfig | None
    T_base: BaseTension
    channels: tuple[str, ...]
    recorded: np.ndarray
    time: np.ndarray | None
    trial: np.ndarray | None
    noise_N: float | None
    stretches: bool = False
    left_out: np.ndarray | None = None
    origin: np.ndarray | None = None

    @property
    def places(self) -> np.ndarray:
        """Places of the samples in the recording, (K,)."""
        return np.arange(self.samples) if self.origin is None else self.origin

    @property
    def counted(self) -> np.ndarray:
        """Samples that are compared, (K,) bool."""
        return np.ones(self.samples, bool) if self.left_out is None else ~self.left_out

    @property
    def T_tip(self) -> np.ndarray:
        """As recorded [N], (K,)."""
        return self.recorded[0]

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.recorded.shape[1]

    @property
    def smallest(self) -> np.ndarray:
        """Error below which each channel is not resolved, whatever its noise, (C,)."""
        tension = max(float(np.max(np.abs(self.T_base.T_base))), float(np.max(np.abs(self.T_tip))), 1e-3)
        size = [tension, *np.ptp(self.recorded[1:], axis=1)]
        return SMALLEST_SIGMA * np.maximum(size, 1e-6)

    def noise(self, fitted: Prediction | None = None, kept: np.ndarray | None = None) -> noise.Noise:
        """Noise of the tip tension, given or estimated. A fitted model improves the estimate: it shows which
        stretches are locked, and replaces the samples that are not kept, (K,) bool.
        """
        if self.noise_N is not None:
            return noise.Noise(self.noise_N, source="given")
        base = self.T_base
        if fitted is None:
            return noise.estimate(base.T_base, self.T_tip, self.trial, None)
        T_tip = self.T_tip if kept is None else np.where(kept, self.T_tip, fitted.T_tip)
        return noise.estimate(base.T_base, T_tip, self.trial, ~fitted.slips)

    def least(self, tip: float | None) -> np.ndarray:
        """Smallest standard deviation that each channel's errors may be given, (C,): the noise of the tip
        tension; for other channels, the difference between neighbouring samples.
        """
        others = [noise.from_differences(row) or 0.0 for row in self.recorded[1:]]
        return np.maximum([tip or 0.0, *others], self.smallest)

    def rough(self) -> np.ndarray:
        """Errors used in the search for a start, (C,): the tip's noise, and for other channels a share of
        their range, because a wrong stiffness puts them far off.
        """
        sd = self.least(self.noise().sd_if_known)
        return np.maximum(sd, [0.0, *(ROUGH * np.ptp(self.recorded[1:], axis=1))])

    def stretch(self, T_tip: np.ndarray) -> np.ndarray:
        """Uncertain stretch of the tendon itself, one standard deviation [m], (K,).

        Every tendon stretches. Unless the robot has a compliance, or no displacement is fitted, the stretch
        is uncertain by the term's typical compliance times the length and the mean tension between base and
        tip. Even friction makes that the logarithmic mean.

        Args:
            T_tip: simulated [N], (K,).
        """
        term = REGISTRY[STRETCH]
        known = self.stretches or known_on(term, self.robot.terms[term.id])
        if known or "displacement" not in self.channels:
            return np.zeros(self.samples)
        ends = np.maximum([self.T_base.T_base, T_tip], 1e-9)
        ratio = np.log(ends[0] / ends[1])
        even = np.abs(ratio) < 1e-6
        mean = np.where(even, ends[0], (ends[0] - ends[1]) / np.where(even, 1.0, ratio))
        return term.quantities[0].typical * float(self.robot.backbone.length) * mean

    def weighing(self, prediction: Prediction, sd: np.ndarray) -> Weighing:
        """The weighing of residuals for a simulation, with one error for each channel, (C,)."""
        stretch = self.stretch(prediction.T_tip)
        return Weighing.of(self.T_base, prediction, self.channels, sd, self.T_base.believed, stretch)

    def residual(self, prediction: Prediction) -> np.ndarray:
        """Simulated minus recorded, (C, K)."""
        return prediction.values - self.recorded

    @property
    def where(self) -> list[int]:
        """Places of the channels in CHANNELS."""
        return [CHANNELS.index(name) for name in self.channels]

    def nodes(self) -> np.ndarray | None:
        """Samples to simulate; None for all of them, as in a recording that is not long."""
        if self.samples <= LONG or self.T_base.sd == 0:
            return None
        travel = float(np.sum(np.abs(np.diff(self.T_base.T_base[self.T_base.knots]))))
        return self.T_base.nodes(max(travel / LONG, FINEST * float(np.ptp(self.T_base.T_base)), 1e-9))

    @functools.cached_property
    def steps(self) -> int:
        """Steps that it is simulated in, padded."""
        nodes = self.nodes()
        return padded_length(self.samples if nodes is None else len(nodes))

    def only(self, samples: np.ndarray) -> Part:
        """Some of the samples."""
        base = self.T_base.only(samples)
        time, trial, left_out = (
            None if v is None else v[samples] for v in (self.time, self.trial, self.left_out)
        )
        return dataclasses.replace(
            self,
            T_base=base,
            recorded=self.recorded[:, samples],
            time=time,
            trial=trial,
            left_out=left_out,
            origin=self.places[samples],
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Setup:
    """What is fitted to what, and how.

    Attributes:
        parts: the recordings.
        free: the p free numbers, those asked for first.
        max_steps: of the optimiser.
        progress: called with a line at each stage.
        profiled: whether profile likelihoods are wanted.
        sampled: whether the posterior is wanted.
        robust: whether outliers are to count less.
    """

    parts: tuple[Part, ...]
    free: tuple[Free, ...]
    max_steps: int
    progress: Callable[[str], None]
    profiled: bool = False
    sampled: bool = False
    robust: bool = False

    @functools.cached_property
    def initial(self) -> np.ndarray:
        """Values in the robot file, SI, (p,)."""
        return np.asarray([f.initial for f in self.free])

    @property
    def priors(self) -> list[float | None]:
        """Standard deviation of each free number by the robot file, SI; None without prior."""
        return [f.prior for f in self.free]

    @property
    def unused_priors(self) -> list[str]:
        """A sentence for each number whose uncertainty cannot be used."""
        return [
            f"The uncertainty of {f.name} is a share of its value, which is 0, and not used: give it "
            f"with its unit{f', {f.entry.unit}' if f.entry.unit else ''}."
            for f in self.free
            for config in (self.parts[f.parts[0]].config,)
            if f.prior is None and config is not None and f.entry.key in config.uncertainty
        ]

    @property
    def names(self) -> list[str]:
        """Names of the free numbers."""
        return [f.name for f in self.free]

    @property
    def asked(self) -> list[Free]:
        """The free numbers that were requested; they come first."""
        return [f for f in self.free if not f.carried]

    def numbers(self, values: np.ndarray) -> list[Number]:
        """The free numbers with the origin of their coordinates at some values (SI, (p,))."""
        return [number_at(f.entry, float(v), name=f.name) for f, v in zip(self.free, values, strict=True)]

    @property
    def samples(self) -> int:
        """Samples of all recordings."""
        return sum(part.samples for part in self.parts)

    @property
    def peak(self) -> float:
        """Largest recorded tip tension [N]."""
        return max(float(np.max(part.T_tip)) for part in self.parts)

    @property
    def stiff(self) -> float:
        """Largest tension [N]."""
        return max(self.peak, *(float(np.max(part.T_base.T_base)) for part in self.parts), 1e-3)

    def friction(self) -> list[int]:
        """Which of the free numbers are friction coefficients."""
        return [i for i, f in enumerate(self.free) if f.entry.name == "mu"]

    @functools.cached_property
    def _places(self) -> list[np.ndarray]:
        """Where the free numbers lie in each recording's robot, (p,) each."""
        return [
            places(part.robot, [f.entry.name for f in self.free], [k in f.parts for f in self.free])
            for k, part in enumerate(self.parts)
        ]

    def coordinates(self, values: np.ndarray) -> tuple[Coordinates, ...]:
        """Coordinates of each recording with their origin at some values (SI, (p,))."""
        return tuple(coordinates(index, self.numbers(values)) for index in self._places)

    def values_of(self, part: int, values: np.ndarray) -> dict[str, float]:
        """Values of the free numbers of one recording's robot, SI, by short name."""
        return {f.entry.name: float(v) for f, v in zip(self.free, values, strict=True) if part in f.parts}

    def objective(self, at: Sequence[Coordinates], parts: Sequence[Part] | None = None) -> Objective:
        """The least squares problem: residuals of recordings, with one error for each channel, and priors.

        Args:
            at: coordinates of each recording.
            parts: the recordings; those of the setup unless given.
        """
        parts = self.parts if parts is None else parts
        log, scale = np.asarray(at[0].log), np.asarray(at[0].scale)
        has = np.asarray([p is not None for p in self.priors])
        sd = np.asarray([p or 1.0 for p in self.priors])
        spread = sd / np.where(log, np.where(self.initial > 0, self.initial, 1.0), scale)
        start = at[0].at(np.where(has, self.initial, np.asarray(at[0].reference)))
        return Objective(
            predictors=tuple(
                Predictor(
                    p.robot,
                    a,
                    p.T_base.T_base,
                    p.time,
                    p.nodes(),
                    p.trial,
                    channels=p.channels,
                    length=whole.steps if whole.steps <= SHARED else 0,
                )
                for p, whole, a in zip(parts, self.parts, at, strict=True)
            ),
            parts=tuple(parts),
            weighs=tuple(Weighing.plain(exact(p.T_base.T_base), p.channels, p.rough()) for p in parts),
            centre=np.where(has, start, 0.0),
            precision=np.where(has, 1 / np.where(has, spread, 1.0), 0.0),
            reach=np.where(log, np.log(LARGEST_FACTOR), LARGEST_SHIFT),
        )


def recorded(recording: Recording) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Base tension, and the channels that can be fitted to by name, T_tip first, (K,) each.

    Raises:
        InputError: no tip tension, columns that do not match, fewer than four samples, numbers that are not
            finite.
    """
    where = recording.path
    if recording.T_tip is None:
        raise InputError(f"{where}: no tip tension to fit to; map it with --columns 'T_tip=NAME[N]'")
    T_base = np.asarray(recording.T_base, float)
    names = [name for name in CHANNELS if getattr(recording, name) is not None]
    channels = {name: np.asarray(getattr(recording, name), float) for name in names}
    further = {} if recording.time is None else {"time": np.asarray(recording.time, float)}
    for name, values in (channels | further).items():
        if T_base.shape != values.shape or T_base.ndim != 1:
            raise InputError(
                f"{where}: T_base and {name} have {T_base.shape} and {values.shape} samples; make them equal"
            )
        if not (np.all(np.isfinite(T_base)) and np.all(np.isfinite(values))):
            raise InputError(f"{where}: T_base or {name} is not finite in places; delete these samples")
    if len(T_base) < 4:
        raise InputError(f"{where}: {len(T_base)} samples are too few to fit to; give 4 or more")
    return T_base, channels


def check_tension(T_base: np.ndarray, robot: Robot, where: str) -> None:
    """Refuse base tensions [N], (K,), that no such robot can take: a sign of a forgotten unit.

    The strain of the outermost fibre is T R r/(E I), here without bores, which only soften the body.

    Raises:
        InputError: naming the recording `where`, and the remedy.
    """
    body = robot.backbone
    if body.rigid:
        return
    s = jnp.linspace(0.0, body.length, 101)
    offset = robot.routing.offset(s, robot.routing.kinks()[:, None] <= s[None, :], body.length)
    lever = np.mean(np.abs(np.asarray(offset.value)) * np.asarray(body.radius(s)) ** -3.0)
    high = float(np.percentile(T_base, OFTEN))
    strain = high * lever / (0.25 * np.pi * float(body.youngs_modulus))
    if strain > MOST_STRAIN:
        raise InputError(
            f"{where}: T_base reaches {high:.4g} N, {strain / MOST_STRAIN:.2g} times the most that bends a "
            "robot of this stiffness; if it is in grams-force, say so, --columns "
            "'T_base=NAME[gf],T_tip=NAME[gf]', else correct backbone.youngs_modulus"
        )


def fitted_to(
    channels: dict[str, np.ndarray],
    wanted: Sequence[str] | None,
    robot: Robot,
    where: str,
) -> tuple[dict[str, np.ndarray], list[str]]:
    """The channels that one recording is fitted to, and a sentence for each that is left out for a fault.

    Args:
        channels: those that it has, T_tip first.
        wanted: those beside T_tip that are wanted; all unless given.
        robot: what was recorded.
        where: the recording, for messages.

    Raises:
        InputError: a position or an angle that no such robot can have.
    """
    length, kept, warnings = float(robot.backbone.length), {"T_tip": channels["T_tip"]}, []
    for name, values in channels.items():
        if name == "T_tip" or (wanted is not None and name not in wanted):
            continue
        most = MOST_TURNS * 2 * np.pi if name == "tip_angle" else MOST_LENGTHS * length
        size = float(np.ptp(values) if name == "displacement" else np.max(np.abs(values)))
        if size > most:
            unit, other = ("rad", "deg") if name == "tip_angle" else ("m", "mm")
            raise InputError(
                f"{where}: {name} reaches {size:.3g} {unit}, more than such a robot can; if it is in "
                f"{other}, call the column {name}_{other}"
            )
        if np.ptp(values) == 0:
            warnings.append(f"{where}: {name} never changes and is not fitted to.")
        elif robot.backbone.rigid:
            warnings.append(f"{where}: {name} is not fitted to, because the backbone is rigid.")
        else:
            kept[name] = values
    return kept, warnings
