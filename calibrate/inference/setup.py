"""What is fitted to what: robots, their free parameters and priors, and recordings."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence

import numpy as np

from gtr_jax import InputError, Recording, Robot, RobotConfig
from gtr_jax.recordings.base_tension import BaseTension
from gtr_jax.recordings.formats.quantities import PER_TENDON
from gtr_jax.recordings.signals import noise
from gtr_jax.robot.parameters import parameter
from gtr_jax.robot.parts import Tendon
from gtr_jax.robot.stiffness import stiffness_of, strain_per_tension
from gtr_jax.simulation.history import padded_length
from gtr_jax.terms import REGISTRY, known_on

from .channels import (
    ROTATION,
    Orientation,
    channels_in,
    chosen_by,
    instrument_of,
    of_tendons,
    quantity_of,
    tendon_of,
    unit_of,
)
from .coordinates import Coordinates, coordinates, places
from .free import Free
from .number import Number, number_at
from .several import SeveralWeighing
from .simulated_readings import Prediction
from .weighing import Weighing

# Least error of a channel, as a share of its size; and its error in the search for a start, as a share of its
# range.
SMALLEST_SIGMA, ROUGH = 1e-6, 0.02
STRETCH = "tendon-stretch"
# What makes a recording one that a fit can use.
COMPARABLE = "T_tip_N, the pose of the tip (tip_x_m, ...), markers of the robot file, or displacement_m"
# Recordings with more samples than LONG are simulated at about LONG of them, or, if that is fewer, at steps
# of the base tension of FINEST of its range.
LONG, FINEST = 2000, 1 / 400
# A tip angle beyond so many turns, or a tip farther away than so many lengths, must be in another unit.
MOST_TURNS, MOST_LENGTHS = 2.0, 2.0
# A base tension that would strain the outermost fibre by so much, on average and without friction, must be in
# another unit. The shared and shipped recordings reach 0.07 to 0.13, and 102 times that if their newtons are
# grams-force. OFTEN is the percentile of the base tension that is checked, so that lone spikes do not count.
MOST_STRAIN, OFTEN = 2.0, 99.0


@dataclasses.dataclass(frozen=True, eq=False)
class Observation:
    """One recording of K samples as it is fitted.

    Attributes:
        name, path: of the recording.
        robot: with the values it starts from.
        config: its file, or None.
        T_base: estimate of the true base tension [N], and how well the recorded one determines it; of the
            first tendon, if there are several. Where displacement drives the tendon, that [m].
        channels: names of what is fitted to, the tip tensions first where they were recorded.
        recorded: their readings, SI, (C, K).
        time: of the samples [s], (K,), or None.
        trial: number of the trial, (K,), or None.
        noise_N: standard deviation of T_tip [N] if given.
        stretches: whether the tendon's stretch is a number of the fit.
        left_out: samples that are simulated and not compared, (K,) bool, or None.
        since: number of the stretch that each sample lies in, (K,), where displacements may be counted from
            another place in each; None for one stretch.
        origin: places of the samples in the recording, (K,), or None for all of them in order.
        others: what drives the other tendons, like T_base.
        orientation: of the tip at the samples, if it is fitted to.
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
    since: np.ndarray | None = None
    origin: np.ndarray | None = None
    others: tuple[BaseTension, ...] = ()
    orientation: Orientation | None = None

    @property
    def drives(self) -> tuple[BaseTension, ...]:
        """What drives each tendon."""
        return (self.T_base, *self.others)

    @property
    def drive(self) -> np.ndarray:
        """What drives the tendons at the samples, without noise, (K, *tendons)."""
        each = [drive.T_base for drive in self.drives]
        return np.stack(each, axis=1) if self.others else each[0]

    @property
    def tips(self) -> int:
        """How many of the channels are tip tensions, which come first: one of each tendon, or none."""
        return sum(quantity_of(name) == "T_tip" for name in self.channels)

    @property
    def explained(self) -> int:
        """How many of the channels, the first, a diagnosis explains: the tip tensions; where none was
        recorded, all at the start that have one unit.
        """
        unit = unit_of(self.channels[0])
        return self.tips or sum(1 for _ in itertools.takewhile(lambda c: unit_of(c) == unit, self.channels))

    @property
    def pulled(self) -> list[np.ndarray]:
        """Base tensions of the tendons that tension drives, (K,) each."""
        return [
            drive.T_base
            for drive, tendon in zip(self.drives, self.robot.tendons, strict=True)
            if tendon.drive == "tension"
        ]

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
        """As recorded [N], (K,), where it was; of the first tendon, if there are several."""
        return self.recorded[0]

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.recorded.shape[1]

    @property
    def smallest(self) -> np.ndarray:
        """Error below which each channel is not resolved, whatever its noise, (C,)."""
        n = self.tips
        tensions = [*self.pulled, *self.recorded[:n]]
        tension = max([*(float(np.max(np.abs(T))) for T in tensions), 1e-3])
        size = [*([tension] * n), *np.ptp(self.recorded[n:], axis=1)]
        return SMALLEST_SIGMA * np.maximum(size, 1e-6)

    def noises(
        self, fitted: Prediction | None = None, kept: np.ndarray | None = None
    ) -> tuple[noise.Noise, ...]:
        """Noise of each tip tension that was recorded, given or estimated. A fitted model improves the
        estimate: it shows which stretches are locked, and replaces the samples that are not kept, (K,) bool.
        """
        if self.noise_N is not None:
            return (noise.Noise(self.noise_N, source="given"),) * self.tips
        found = []
        for i, (base, T_tip) in enumerate(zip(self.drives, self.recorded[: self.tips], strict=False)):
            locked = None
            if fitted is not None:
                locked = ~fitted.slips.reshape(len(T_tip), -1)[:, i]
                T_tip = T_tip if kept is None else np.where(kept, T_tip, fitted.values[i])
            found.append(noise.estimate(base.T_base, T_tip, self.trial, locked))
        return tuple(found)

    def least(self, tips: Sequence[noise.Noise]) -> np.ndarray:
        """Smallest standard deviation that each channel's errors may be given, (C,): the noise of the tip
        tensions; for other channels, the difference between neighbouring samples.
        """
        others = [noise.from_differences(row) or 0.0 for row in self.recorded[self.tips :]]
        return self.pooled(np.maximum([*(tip.sd_if_known or 0.0 for tip in tips), *others], self.smallest))

    def pooled(self, sizes: np.ndarray) -> np.ndarray:
        """Errors of the channels, (C,), the same for all that one instrument measures: their root mean
        square. A model that falls short of some markers must not count those less than the others.
        """
        return np.sqrt(self.pooled_squares(np.square(sizes)))

    def pooled_squares(self, squares: np.ndarray) -> np.ndarray:
        """Squares of the channels, (C,), for each the mean over all that its instrument measures."""
        names = np.array([instrument_of(name) for name in self.channels])
        return np.array([np.mean(squares[names == name]) for name in names])

    def rough(self) -> np.ndarray:
        """Errors used in the search for a start, (C,): the tips' noise, and for other channels a share of
        their range, because a wrong stiffness puts them far off.
        """
        sd, n = self.least(self.noises()), self.tips
        return np.maximum(sd, [*([0.0] * n), *(ROUGH * np.ptp(self.recorded[n:], axis=1))])

    def stretch(self, T_tip: np.ndarray) -> np.ndarray:
        """Uncertain stretch of the tendon of each channel, one standard deviation [m], (C, K); zero but for
        displacements.

        Every tendon stretches. Unless the robot has a compliance, or no displacement is fitted, the stretch
        is uncertain by the term's typical compliance times the length and the mean tension between base and
        tip. Even friction makes that the logarithmic mean.

        Args:
            T_tip: simulated [N], (K,), of several tendons (tendons, K).
        """
        term = REGISTRY[STRETCH]
        found = np.zeros(self.recorded.shape)
        if self.stretches or known_on(term, self.robot.terms[term.id]):
            return found
        for c, name in enumerate(self.channels):
            if quantity_of(name) != "displacement":
                continue
            i = tendon_of(name, self.robot)
            stiffness = self.robot.tendons[i].axial_stiffness
            if stiffness is not None and np.isfinite(float(stiffness)):
                continue
            ends = np.maximum([self.drives[i].T_base, T_tip.reshape(-1, self.samples)[i]], 1e-9)
            ratio = np.log(ends[0] / ends[1])
            even = np.abs(ratio) < 1e-6
            mean = np.where(even, ends[0], (ends[0] - ends[1]) / np.where(even, 1.0, ratio))
            found[c] = term.quantities[0].typical * float(self.robot.backbone.length) * mean
        return found

    def weighing(
        self,
        slips: np.ndarray,
        slopes: Sequence[np.ndarray | None],
        sd: np.ndarray,
        stretch: np.ndarray | None = None,
    ) -> Weighing:
        """The weighing of residuals, with one error for each channel, by what a simulation shows.

        Args:
            slips: whether slip reaches the anchor, (K, *tendons).
            slopes: change of the channels by what drives each tendon, (C, K) each; None takes that as exact.
            sd: standard deviations of the channels, (C,).
            stretch: as from `stretch`; the tendons do not stretch unless given.
        """
        stretch = np.zeros(self.recorded.shape) if stretch is None else stretch
        if self.others:
            weigh = SeveralWeighing.of_all(self.drives, slips, slopes, self.channels, sd, stretch)
        else:
            weigh = Weighing.of(self.T_base, slips, slopes[0], self.channels, sd, stretch)
        return dataclasses.replace(weigh, since=self.since).only(self.counted)

    def residual(self, prediction: Prediction) -> np.ndarray:
        """Simulated minus recorded, (C, K)."""
        return prediction.values - self.recorded

    def nodes(self) -> np.ndarray | None:
        """Samples to simulate; None for all of them, as in a recording that is not long."""
        if self.samples <= LONG or self.T_base.sd == 0 or self.others:
            return None
        travel = float(np.sum(np.abs(np.diff(self.T_base.T_base[self.T_base.knots]))))
        return self.T_base.nodes(max(travel / LONG, FINEST * float(np.ptp(self.T_base.T_base)), 1e-9))

    @functools.cached_property
    def steps(self) -> int:
        """Steps that it is simulated in, padded."""
        nodes = self.nodes()
        return padded_length(self.samples if nodes is None else len(nodes))

    def only(self, samples: np.ndarray) -> Observation:
        """Some of the samples."""
        base = self.T_base.only(samples)
        time, trial, left_out, since = (
            None if v is None else v[samples] for v in (self.time, self.trial, self.left_out, self.since)
        )
        return dataclasses.replace(
            self,
            T_base=base,
            recorded=self.recorded[:, samples],
            time=time,
            trial=trial,
            left_out=left_out,
            since=since,
            origin=self.places[samples],
            others=tuple(drive.only(samples) for drive in self.others),
            orientation=None if self.orientation is None else self.orientation.only(samples),
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

    parts: tuple[Observation, ...]
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
    def peak(self) -> float | None:
        """Largest recorded tip tension [N]; None if none was recorded."""
        each = [float(np.max(part.recorded[: part.tips])) for part in self.parts if part.tips]
        return max(each, default=None)

    @property
    def stiff(self) -> float:
        """Largest tension [N]."""
        each = [float(np.max(T)) for part in self.parts for T in part.pulled]
        return max([self.peak or 0.0, *each, 1e-3])

    def friction(self) -> list[int]:
        """Which of the free numbers are friction coefficients."""
        return [i for i, f in enumerate(self.free) if f.entry.name.partition(".")[0] == "mu"]

    @functools.cached_property
    def _places(self) -> list[np.ndarray]:
        """Where the free numbers lie in each recording's robot, (p,) each."""
        return self._places_without(np.zeros(len(self.free), bool))

    def _places_without(self, held: np.ndarray) -> list[np.ndarray]:
        """The same where some numbers, (p,) bool, are as if no robot had them."""
        names = [f.entry.name for f in self.free]
        return [
            places(part.robot, names, [k in f.parts and not h for f, h in zip(self.free, held, strict=True)])
            for k, part in enumerate(self.parts)
        ]

    def coordinates(self, values: np.ndarray, held: np.ndarray | None = None) -> tuple[Coordinates, ...]:
        """Coordinates of each recording with their origin at some values (SI, (p,)). Numbers that are held,
        (p,) bool, stay as the robot file has them, absent where it has none, whatever their coordinates.
        """
        index = self._places if held is None else self._places_without(held)
        return tuple(coordinates(own, self.numbers(values)) for own in index)

    def values_of(self, part: int, values: np.ndarray) -> dict[str, float]:
        """Values of the free numbers of one recording's robot, SI, by short name."""
        return {f.entry.name: float(v) for f, v in zip(self.free, values, strict=True) if part in f.parts}


def check_noise(noise_N: float | None, parts: Sequence[Observation]) -> None:
    """Refuse a noise of the cell at the tip where no recording has one."""
    if noise_N is not None and not any(part.tips for part in parts):
        raise InputError("noise_N: no recording has a tip tension, whose noise this is; leave out --noise")


def check_columns(recording: Recording, robot: Robot) -> None:
    """Refuse a recording that does not have exactly one column for each tendon.

    Raises:
        InputError: naming the recording, the quantity and the shape that it should have.
    """
    own = (len(robot.tendons),) if robot.tendon_names else ()
    for quantity in PER_TENDON:
        values = getattr(recording, quantity)
        if values is not None and np.shape(values)[1:] != own:
            raise InputError(
                f"{recording.path}: {quantity} has the shape {np.shape(values)}, for a robot of "
                f"{len(robot.tendons)} tendons; give {(len(recording), *own)}"
            )


def recorded(recording: Recording, robot: Robot) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """What drives the tendons, (K, *tendons), and the channels that can be fitted to by name, the tip
    tensions first, (K,) each.

    Raises:
        InputError: tip tensions of some tendons only, columns that do not match, fewer than four samples,
            numbers that are not finite.
    """
    where = recording.path
    drive = np.array(recording.T_base, float)
    drawn = np.asarray([tendon.drive == "displacement" for tendon in robot.tendons])
    drawn = drawn.reshape(drive.shape[1:])
    if drawn.any():
        if recording.displacement is None:
            raise InputError(f"{where}: no displacement, which drives {robot.name}; add displacement_m")
        drive = np.where(drawn, np.asarray(recording.displacement, float), drive)
    channels = channels_in(recording, robot)
    lacking = [name for name in of_tendons("T_tip", robot) if name not in channels]
    if lacking and recording.T_tip is not None:
        raise InputError(f"{where}: no {lacking[0]} to fit to; add the column, or leave the tendon out")
    further = {} if recording.time is None else {"time": np.asarray(recording.time, float)}
    for name, values in (channels | further).items():
        if len(values) != len(drive) or values.ndim != 1:
            raise InputError(
                f"{where}: T_base and {name} have {drive.shape} and {values.shape} samples; make them equal"
            )
        if not (np.all(np.isfinite(drive)) and np.all(np.isfinite(values))):
            raise InputError(f"{where}: T_base or {name} is not finite in places; delete these samples")
    if len(drive) < 4:
        raise InputError(f"{where}: {len(drive)} samples are too few to fit to; give 4 or more")
    return drive, channels


def check_tension(T_base: np.ndarray, robot: Robot, where: str, tendon: Tendon) -> None:
    """Refuse base tensions [N], (K,), that no such robot can take: a sign of a forgotten unit.

    What is compared is the strain of the outermost fibre, T R r/(E I) by `strain_per_tension`.

    Raises:
        InputError: naming the recording `where`, and the remedy.
    """
    high = float(np.percentile(T_base, OFTEN))
    strain = high * strain_per_tension(robot, tendon)
    if strain > MOST_STRAIN:
        key = parameter(robot, stiffness_of(robot)[0]).key
        raise InputError(
            f"{where}: T_base reaches {high:.4g} N, {strain / MOST_STRAIN:.2g} times the most that bends a "
            "robot of this stiffness; if it is in grams-force, say so, --columns "
            f"'T_base=NAME[gf],T_tip=NAME[gf]', else correct {key}"
        )


def fitted_to(
    channels: dict[str, np.ndarray],
    wanted: Sequence[str] | None,
    robot: Robot,
    where: str,
) -> tuple[dict[str, np.ndarray], list[str]]:
    """The channels that one recording is fitted to, and a sentence for each that is left out for a fault.

    Args:
        channels: those that it has.
        wanted: those beside T_tip that are wanted; all unless given.
        robot: what was recorded.
        where: the recording, for messages.

    Raises:
        InputError: a position or an angle that no such robot can have; nothing that is left to compare.
    """
    kept, warnings, unasked = {}, [], []
    far = MOST_LENGTHS * float(robot.backbone.length) + float(np.linalg.norm(robot.base.position))
    for name, values in channels.items():
        quantity = quantity_of(name)
        if quantity == "T_tip":
            kept[name] = values
            continue
        if wanted is not None and not set(chosen_by(name)) & set(wanted):
            unasked.append(name)
            continue
        angle = unit_of(name) == "rad"
        most = MOST_TURNS * 2 * np.pi if angle else far
        if quantity in ("T_base", *ROTATION):
            most = np.inf
        size = float(np.ptp(values) if quantity == "displacement" else np.max(np.abs(values)))
        if size > most:
            unit, other = ("rad", "deg") if angle else ("m", "mm")
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
    if not kept:
        others = [words.removeprefix(f"{where}: ").removesuffix(".") for words in warnings]
        why = f" ({'; '.join(others)})" if others else ""
        remedy = f"ask for some of {', '.join(unasked)}" if unasked else f"add {COMPARABLE}"
        raise InputError(f"{where}: no tip tension, and nothing else to compare{why}; {remedy}")
    return kept, warnings
