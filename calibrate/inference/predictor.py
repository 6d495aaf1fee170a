"""What the instruments would show of a load history, and its derivatives where they are wanted."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gtr_jax import Robot, Simulation, reading, simulate, true_base
from gtr_jax.robot.parts import Tendon
from gtr_jax.simulation.history import cycles, padded_length
from gtr_jax.simulation.markers import marker_readings, marker_rows
from gtr_jax.simulation.phases import phases_of_slip
from gtr_jax.stored import Stored

from .channels import CHANNELS, ROTATION, Orientation, of_tendons, quantity_of, tendon_of, turned_by
from .coordinates import Coordinates
from .parallel import in_parallel

OF_TENDONS = ("T_tip", "T_base", "displacement")
# Step of differences, in coordinates and as a share of the range of what drives a tendon.
STEP = 1e-4
# Padded load histories kept in memory: a fit and a diagnosis reuse the same few.
HISTORIES = 64


class History(eqx.Module):
    """A load history, held at its end until it has one of the few lengths that are compiled, P.

    Attributes:
        T_base: base tension as its cell shows it [N], (P, *tendons).
        time: [s], (P,).
        cycle: pulls and releases done, (P,); see `gtr_jax.simulate`.
        displacement: of the tendons that displacement drives [m], (P, *tendons); None where it drives none.
        orientation: of the tip, as recorded; None where it is not compared.
    """

    T_base: Float[Array, "P *tendons"]
    time: Float[Array, " P"]
    cycle: Float[Array, " P"]
    displacement: Float[Array, "P *tendons"] | None = None
    orientation: Orientation | None = None

    def driven_by(self, more: Float[Array, " tendons"]) -> History:
        """A copy with what drives each tendon, a tension or a displacement, changed throughout."""
        more = more[0] if self.T_base.ndim == 1 else more[None]
        if self.displacement is None:
            return dataclasses.replace(self, T_base=self.T_base + more)
        # Of the two, a tendon reads the one that drives it.
        return dataclasses.replace(self, T_base=self.T_base + more, displacement=self.displacement + more)


def simulated(robot: Robot, history: History) -> Simulation:
    """The simulation of a load history."""
    T_base = true_base(robot, history.T_base, history.time)
    return simulate(robot, T_base, time=history.time, cycle=history.cycle, displacement=history.displacement)


def shown(
    robot: Robot, history: History, channels: Sequence[str] = CHANNELS
) -> tuple[Float[Array, "C P"], Simulation]:
    """What the instruments show of a load history on some channels, SI, and the simulation."""
    run = simulated(robot, history)
    rows = {f"tip_{axis}": row for axis, row in zip("xyz", run.tip_position.T, strict=True)}
    rows["tip_angle"] = run.tip_pose[:, 2]
    if history.orientation is not None:
        turned = turned_by(run.tip_rotation, history.orientation)
        rows |= dict(zip(ROTATION, turned.T, strict=True))
    if robot.markers and any(quantity_of(name) not in (*rows, *OF_TENDONS) for name in channels):
        rows |= marker_rows(robot, marker_readings(robot, run))
    seen = reading(robot, run)
    ends = {"T_tip": seen.T_tip, "T_base": seen.T_base, "displacement": run.displacement}

    def row(name: str) -> Float[Array, " P"]:
        if name in rows:
            return rows[name]
        values = ends[quantity_of(name)]
        return values[:, tendon_of(name, robot)] if robot.tendon_names else values

    return jnp.stack([row(name) for name in channels]), run


def padded_history(
    T_base: np.ndarray,
    time: np.ndarray | None,
    trial: np.ndarray | None,
    length: int = 0,
    *,
    drawn: tuple[bool, ...] = (False,),
    orientation: Orientation | None = None,
) -> History:
    """A load history of K samples, one second apart where times are missing. Trials count as cycles where
    there is more than one. It is padded to a length for which programs are compiled, or to `length` if that
    is more.

    Args:
        T_base: what drives the tendons, (K, *tendons): tensions [N], or displacements [m] of those that are
            drawn.
        time, trial: of the samples, (K,).
        length: least number of steps.
        drawn: which tendons displacement drives, (tendons,).
        orientation: of the tip at the samples.
    """
    contents = [None if a is None else np.asarray(a, float).tobytes() for a in (T_base, time, trial)]
    length = max(length, padded_length(len(T_base)))
    history = _padded_history(*contents, T_base.shape[1:], length)
    if any(drawn):
        which = np.broadcast_to(np.reshape(drawn, T_base.shape[1:]), history.T_base.shape)
        history = dataclasses.replace(
            history,
            T_base=jnp.where(which, 0.0, history.T_base),
            displacement=jnp.where(which, history.T_base, 0.0),
        )
    if orientation is None:
        return history
    held = np.minimum(np.arange(length), len(T_base) - 1)
    padded = Orientation(*(jnp.asarray(values) for values in orientation.only(held)))
    return dataclasses.replace(history, orientation=padded)


@functools.lru_cache(HISTORIES)
def _padded_history(
    T_base: bytes, time: bytes | None, trial: bytes | None, tendons: tuple[int, ...], length: int
) -> History:
    drive = np.frombuffer(T_base).reshape(-1, *tendons)
    clock = np.arange(len(drive), dtype=float) if time is None else np.frombuffer(time)
    missing = length - len(drive)
    last = clock[-1] - clock[-2] if len(clock) > 1 else 1.0
    done = np.zeros(0) if trial is None else np.unique(np.frombuffer(trial), return_inverse=True)[1]
    if not np.any(done):
        done = np.asarray(_cycles(jnp.asarray(drive)))
    return History(
        T_base=jnp.asarray(np.concatenate([drive, np.broadcast_to(drive[-1], (missing, *tendons))])),
        time=jnp.asarray(np.concatenate([clock, clock[-1] + last * np.arange(1, missing + 1)])),
        cycle=jnp.asarray(np.concatenate([done, np.full(missing, done[-1])]), float),
    )


_cycles = eqx.filter_jit(cycles)


@dataclasses.dataclass(frozen=True, eq=False)
class SimulatedReadings:
    """What a simulation shows of a recording of K samples.

    Attributes:
        values: what the instruments would show, SI, (C, K).
        failed: load steps that did not meet their tolerance.
        slips: whether slip reaches the anchor, (K, *tendons).
        direction: of the slip at the base, (K, *tendons).
    """

    values: np.ndarray
    failed: int
    slips: np.ndarray
    direction: np.ndarray

    @property
    def tips(self) -> int:
        """How many of the values are tip tensions, one for each tendon."""
        return 1 if self.slips.ndim == 1 else self.slips.shape[1]

    @property
    def converged(self) -> bool:
        """Whether every load step met its tolerance."""
        return self.failed == 0

    @property
    def phases(self) -> np.ndarray:
        """Phase of each sample, (K, *tendons)."""
        if self.slips.ndim == 1:
            return phases_of_slip(self.slips, self.direction)
        each = map(phases_of_slip, self.slips.T, self.direction.T)
        return np.stack(list(each), axis=1)

    def flat(self) -> np.ndarray:
        """All in one array, which ends with the number of tendons: 0 without a tendon axis."""
        tendons = 0 if self.slips.ndim == 1 else self.tips
        each = (self.values, self.slips.T, self.direction.T)
        return np.concatenate([*(np.ravel(values) for values in each), [self.failed, tendons]])

    @staticmethod
    def of(flat: np.ndarray, samples: int) -> SimulatedReadings | None:
        """The inverse of `flat`; None for an empty array."""
        if not len(flat):
            return None
        failed, tendons = (int(number) for number in flat[-2:])
        rows, n = np.array(flat[:-2].reshape(-1, samples)), max(tendons, 1)
        slips, direction = rows[-2 * n : -n].T > 0, rows[-n:].T
        return SimulatedReadings(
            values=rows[: -2 * n],
            failed=failed,
            slips=slips if tendons else slips[:, 0],
            direction=direction if tendons else direction[:, 0],
        )

    def plus(self, channels: list[int], more: np.ndarray) -> SimulatedReadings:
        """A copy with `more`, (channels, K), added to some channels."""
        values = np.array(self.values)
        values[channels] += more
        return dataclasses.replace(self, values=values)


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction(SimulatedReadings):
    """What a simulation shows, and its derivatives by p coordinates.

    Attributes:
        T_tip: simulated tension at the tip of each tendon [N], (tendons, K), among the values or not.
        jacobian: derivatives of the values by u, (C, K, p).
        slope: derivative of the values with respect to a uniform shift of the base tension, per newton, (C,
            K); of several tendons, one for each, (C, K, tendons); of a tendon that displacement drives, with
            respect to that, per metre. While friction holds the tip, that of T_tip is the one at the sample
            where it slipped last.
    """

    T_tip: np.ndarray
    jacobian: np.ndarray
    slope: np.ndarray


def unless_broken(run: Callable[[], Any]) -> Any:
    """What a compiled program returns; None where the simulator breaks down."""
    try:
        return jax.block_until_ready(run())
    except RuntimeError as fault:  # a linear solve given NaN raises, from within the compiled program
        if "non-finite" not in str(fault):
            raise
        return None


@Stored
def _predict(
    robot: Robot, at: Coordinates, history: History, u: Float[Array, " p"], channels: tuple[str, ...]
) -> tuple[Array, ...]:
    """Values (C, P), their derivatives by u and by what drives each tendon, (C, P, p+tendons), and of each
    step whether it converged, (P,), how far slip reaches and its direction at the base, (P, *tendons).
    """
    p, tendons = u.shape[0], len(robot.tendons)

    def at_coordinates(u, more):
        values, run = shown(at.robot_at(robot, u), history.driven_by(more), channels)
        return values, (run.solved, run.slip_front, run.slip_direction)

    def along(direction):
        return jax.jvp(at_coordinates, (u, jnp.zeros(tendons)), (direction[:p], direction[p:]), has_aux=True)

    values, slopes, steps = jax.vmap(along, out_axes=(None, -1, None))(jnp.eye(p + tendons))
    return values, slopes, *steps


@Stored
def _show(
    robot: Robot,
    at: Coordinates,
    history: History,
    u: Float[Array, " p"],
    more: Float[Array, " tendons"],
    channels: tuple[str, ...],
) -> tuple[Array, ...]:
    """As `_predict`, without derivatives, with what drives the tendons changed throughout."""
    values, run = shown(at.robot_at(robot, u), history.driven_by(more), channels)
    return values, run.solved, run.slip_front, run.slip_direction


def _by_differences(
    robot: Robot, at: Coordinates, history: History, u: np.ndarray, channels: tuple[str, ...]
) -> tuple[np.ndarray, ...]:
    """What `_predict` returns, its derivatives by central differences: tendons that displacement drives are
    solved for by a search in every step, whose forward mode takes minutes and gigabytes to compile.
    """
    drawn = np.asarray([tendon.drive == "displacement" for tendon in robot.tendons])
    span = np.where(drawn, np.ptp(np.asarray(history.displacement)), np.ptp(np.asarray(history.T_base)))
    steps = STEP * np.concatenate([np.ones(len(u)), np.where(span > 0, span, 1.0)])
    whole = np.concatenate([u, np.zeros(len(drawn))])

    def shown_at(x: np.ndarray) -> list[np.ndarray]:
        found = _show(robot, at, history, jnp.asarray(x[: len(u)]), jnp.asarray(x[len(u) :]), channels)
        return [np.asarray(values) for values in found]

    values, *outcome = shown_at(whole)
    slopes = [
        (shown_at(whole + row)[0] - shown_at(whole - row)[0]) / (2 * step)
        for row, step in zip(np.diag(steps), steps, strict=True)
    ]
    return values, np.stack(slopes, axis=-1), *outcome


class Predictor:
    """Simulates one load history at any coordinates, with derivatives.

    One compiled program per robot structure, padded length, channels and number of free parameters; forward
    mode, because the parameters are few: the derivatives come with the simulation at little more than its
    cost. By differences where displacement drives a tendon.

    Args:
        robot: robot whose other parameters stay.
        at: coordinates of the free ones.
        T_base: base tension as its cell shows it [N], (K, *tendons); the displacement [m] of tendons that it
            drives.
        time: of the samples [s], (K,); one second apart unless given.
        nodes: samples that are simulated, (J,), increasing from the first to the last; all unless given.
            Samples between two nodes are interpolated in T_base, which must not turn there; during a hold, in
            time. All are simulated where the robot has several tendons.
        trial: number of the trial, (K,), or None.
        channels: what is predicted, in the order of CHANNELS; all unless given.
        length: least number of steps that the program is compiled for, so that recordings can share one.
        orientation: of the tip at the samples, where it is compared.

    Attributes:
        samples, steps: how many there are to predict, K, and to simulate, J.
        history: at the steps, padded.
    """

    def __init__(
        self,
        robot: Robot,
        at: Coordinates,
        T_base: np.ndarray,
        time: np.ndarray | None = None,
        nodes: np.ndarray | None = None,
        trial: np.ndarray | None = None,
        *,
        channels: tuple[str, ...] = CHANNELS,
        length: int = 0,
        orientation: Orientation | None = None,
    ):
        self.robot, self.at, self.samples, self.channels = robot, at, len(T_base), channels
        tips = of_tendons("T_tip", robot)
        # Tip tensions that are not compared follow what is.
        self._shown = (*channels, *(name for name in tips if name not in channels))
        self._tips = [self._shown.index(name) for name in tips]
        nodes = np.arange(self.samples) if nodes is None else nodes
        self.steps = len(nodes)
        clock, number = (None if v is None else v[nodes] for v in (time, trial))
        self.history = padded_history(
            T_base[nodes],
            clock,
            number,
            length,
            drawn=tuple(tendon.drive == "displacement" for tendon in robot.tendons),
            orientation=None if orientation is None else orientation.only(nodes),
        )
        self._next = np.searchsorted(nodes, np.arange(self.samples))
        self._before = np.maximum(self._next - (nodes[self._next] != np.arange(self.samples)), 0)
        self._share = np.ones(self.samples)
        if self.steps == self.samples:
            return
        low, high = T_base[nodes[self._before]], T_base[nodes[self._next]]
        rise = np.where(high == low, 1.0, high - low)
        # During a hold only time-dependent effects go on.
        clock = np.arange(self.samples) if time is None else time
        first, last = clock[nodes[self._before]], clock[nodes[self._next]]
        held = np.where(last > first, (clock - first) / np.where(last > first, last - first, 1.0), 1.0)
        self._share = np.where(high == low, held, (T_base - low) / rise)

    @property
    def interpolation(self) -> tuple[Int[Array, " K"], Int[Array, " K"], Float[Array, " K"]]:
        """Steps before and after each sample, and its share of the way between them."""
        return jnp.asarray(self._before), jnp.asarray(self._next), jnp.asarray(self._share)

    def _at_samples(self, values: np.ndarray) -> np.ndarray:
        """From the nodes, (C, J, ...), to the samples, (C, K, ...)."""
        if self.steps == self.samples:
            return values
        share = self._share.reshape(-1, *[1] * (values.ndim - 2))
        return (1 - share) * values[:, self._before] + share * values[:, self._next]

    def __call__(self, u: np.ndarray) -> Prediction | None:
        """The recording at coordinates u, (p,); None where the simulator breaks down."""
        u = np.asarray(u, float)
        drawn = self.history.displacement is not None
        found = unless_broken(
            lambda: (
                _by_differences(self.robot, self.at, self.history, u, self._shown)
                if drawn
                else _predict(self.robot, self.at, self.history, jnp.asarray(u), self._shown)
            )
        )
        if found is None:
            return None
        values, slopes, converged, front, direction = found
        values, slopes = (self._at_samples(np.asarray(v)[:, : self.steps]) for v in (values, slopes))
        if not (np.all(np.isfinite(values)) and np.all(np.isfinite(slopes))):
            return None
        length = np.asarray(self.robot.per_tendon(self._anchored))
        whole = np.asarray(front) >= length * (1 - 1e-12)
        T_tip, C = values[self._tips], len(self.channels)
        values, slopes = values[:C], slopes[:C]
        slope = slopes[..., len(u) :]
        return Prediction(
            values=values,
            T_tip=T_tip,
            failed=int(np.sum(~np.asarray(converged)[: self.steps])),
            slips=whole[self._next],
            direction=np.asarray(direction)[self._next],
            jacobian=slopes[..., : len(u)],
            slope=slope if self.robot.tendon_names else slope[..., 0],
        )

    def _anchored(self, tendon: Tendon) -> Float[Array, ""]:
        """Arc length at which a tendon ends [m]."""
        return self.robot.backbone.length if tendon.to is None else tendon.to


def predict_all(parts: Sequence[Predictor], u: np.ndarray) -> tuple[Prediction, ...] | None:
    """Several recordings at the same coordinates, one prediction each; None where the simulator breaks down
    for one.
    """
    every = in_parallel(lambda part: part(u), parts)
    found = tuple(prediction for prediction in every if prediction is not None)
    return found if len(found) == len(parts) else None
