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
from gtr_jax.simulation.history import cycles, padded_length
from gtr_jax.simulation.phases import phases_of_slip
from gtr_jax.stored import Stored

from .coordinates import Coordinates
from .parallel import in_parallel

# What instruments may show, with its units; names are those of `gtr_jax.Recording`.
CHANNELS = ("T_tip", "tip_x", "tip_y", "tip_angle", "displacement")
CHANNEL_UNITS = ("N", "m", "m", "rad", "m")
# Padded load histories kept in memory: a fit and a diagnosis reuse the same few.
HISTORIES = 64


class History(eqx.Module):
    """A load history, held at its end until it has one of the few lengths that are compiled, P.

    Attributes:
        T_base: base tension as its cell shows it [N], (P,).
        time: [s], (P,).
        cycle: pulls and releases done, (P,); see `gtr_jax.simulate`.
    """

    T_base: Float[Array, " P"]
    time: Float[Array, " P"]
    cycle: Float[Array, " P"]


def shown(
    robot: Robot, history: History, channels: Sequence[str] = CHANNELS
) -> tuple[Float[Array, "C P"], Simulation]:
    """What the instruments show of a load history on some channels, SI, and the simulation."""
    T_base = true_base(robot, history.T_base, history.time)
    run = simulate(robot, T_base, time=history.time, cycle=history.cycle)
    every = (reading(robot, run).T_tip, *run.tip_pose.T, run.displacement)
    return jnp.stack([row for name, row in zip(CHANNELS, every, strict=True) if name in channels]), run


def padded_history(
    T_base: np.ndarray, time: np.ndarray | None, trial: np.ndarray | None, length: int = 0
) -> History:
    """A load history of K samples, one second apart where times are missing. Trials count as cycles where
    there is more than one. It is padded to a length for which programs are compiled, or to `length` if that
    is more.
    """
    contents = [None if a is None else np.asarray(a, float).tobytes() for a in (T_base, time, trial)]
    return _padded_history(*contents, max(length, padded_length(len(T_base))))


@functools.lru_cache(HISTORIES)
def _padded_history(T_base: bytes, time: bytes | None, trial: bytes | None, length: int) -> History:
    tensions = np.frombuffer(T_base)
    clock = np.arange(len(tensions), dtype=float) if time is None else np.frombuffer(time)
    missing = length - len(tensions)
    last = clock[-1] - clock[-2] if len(clock) > 1 else 1.0
    done = np.zeros(0) if trial is None else np.unique(np.frombuffer(trial), return_inverse=True)[1]
    if not np.any(done):
        done = np.asarray(_cycles(jnp.asarray(tensions)))
    return History(
        T_base=jnp.asarray(np.concatenate([tensions, np.full(missing, tensions[-1])])),
        time=jnp.asarray(np.concatenate([clock, clock[-1] + last * np.arange(1, missing + 1)])),
        cycle=jnp.asarray(np.concatenate([done, np.full(missing, done[-1])]), float),
    )


_cycles = eqx.filter_jit(cycles)


@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """What a simulation shows of a recording of K samples.

    Attributes:
        values: what the instruments would show, SI, (C, K).
        failed: load steps that did not meet their tolerance.
        slips: whether slip reaches the tip, (K,).
        direction: of the slip at the base, (K,).
    """

    values: np.ndarray
    failed: int
    slips: np.ndarray
    direction: np.ndarray

    @property
    def T_tip(self) -> np.ndarray:
        """Tip tension [N], (K,)."""
        return self.values[0]

    @property
    def converged(self) -> bool:
        """Whether every load step met its tolerance."""
        return self.failed == 0

    @property
    def phases(self) -> np.ndarray:
        """Phase of each sample, (K,)."""
        return phases_of_slip(self.slips, self.direction)

    def flat(self) -> np.ndarray:
        """All in one array."""
        return np.concatenate([self.values.ravel(), self.slips, self.direction, [self.failed]])

    @staticmethod
    def of(flat: np.ndarray, samples: int) -> Seen | None:
        """The inverse of `flat`; None for an empty array."""
        if not len(flat):
            return None
        rows = flat[:-1].reshape(-1, samples)
        return Seen(
            values=np.array(rows[:-2]), failed=int(flat[-1]), slips=rows[-2] > 0, direction=np.array(rows[-1])
        )

    def plus(self, channels: list[int], more: np.ndarray) -> Seen:
        """A copy with `more`, (channels, K), added to some channels."""
        values = np.array(self.values)
        values[channels] += more
        return dataclasses.replace(self, values=values)


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction(Seen):
    """What a simulation shows, and its derivatives by p coordinates.

    Attributes:
        jacobian: derivatives of the values by u, (C, K, p).
        slope: derivative of the values with respect to a uniform shift of the base tension, per newton, (C,
            K); while friction holds the tip, that of T_tip is the one at the sample where it slipped last.
    """

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
    """Values (C, P), their derivatives (C, P, p+1), and of each step, (P,), whether it converged, how far
    slip reaches and its direction at the base.
    """
    T_base = history.T_base

    def at_coordinates(u, T_base):
        changed = dataclasses.replace(history, T_base=T_base)
        values, run = shown(at.robot_at(robot, u), changed, channels)
        return values, (run.converged, run.slip_front, run.slip_direction)

    def along(direction):
        raised = jnp.broadcast_to(direction[-1], T_base.shape)
        return jax.jvp(at_coordinates, (u, T_base), (direction[:-1], raised), has_aux=True)

    values, slopes, steps = jax.vmap(along, out_axes=(None, -1, None))(jnp.eye(u.shape[0] + 1))
    return values, slopes, *steps


class Predictor:
    """Simulates one load history at any coordinates, with derivatives.

    One compiled program per robot structure, padded length, channels and number of free parameters; forward
    mode, because the parameters are few: the derivatives come with the simulation at little more than its
    cost.

    Args:
        robot: robot whose other parameters stay.
        at: coordinates of the free ones.
        T_base: base tension as its cell shows it [N], (K,).
        time: of the samples [s], (K,); one second apart unless given.
        nodes: samples that are simulated, (J,), increasing from the first to the last; all unless given.
            Samples between two nodes are interpolated in T_base, which must not turn there; during a hold, in
            time.
        trial: number of the trial, (K,), or None.
        channels: what is predicted, in the order of CHANNELS; all unless given.
        length: least number of steps that the program is compiled for, so that recordings can share one.

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
    ):
        self.robot, self.at, self.samples, self.channels = robot, at, len(T_base), channels
        nodes = np.arange(self.samples) if nodes is None else nodes
        self.steps = len(nodes)
        clock, number = (None if v is None else v[nodes] for v in (time, trial))
        self.history = padded_history(T_base[nodes], clock, number, length)
        self._next = np.searchsorted(nodes, np.arange(self.samples))
        self._before = np.maximum(self._next - (nodes[self._next] != np.arange(self.samples)), 0)
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
        found = unless_broken(
            lambda: _predict(self.robot, self.at, self.history, jnp.asarray(u, float), self.channels)
        )
        if found is None:
            return None
        values, slopes, converged, front, direction = found
        values, slopes = (self._at_samples(np.asarray(v)[:, : self.steps]) for v in (values, slopes))
        if not (np.all(np.isfinite(values)) and np.all(np.isfinite(slopes))):
            return None
        whole = np.asarray(front) >= float(self.robot.backbone.length) * (1 - 1e-12)
        return Prediction(
            values=values,
            failed=int(np.sum(~np.asarray(converged)[: self.steps])),
            slips=whole[self._next],
            direction=np.asarray(direction)[self._next],
            jacobian=slopes[..., :-1],
            slope=slopes[..., -1],
        )


def predict_all(parts: Sequence[Predictor], u: np.ndarray) -> tuple[Prediction, ...] | None:
    """Several recordings at the same coordinates, one prediction each; None where the simulator breaks down
    for one.
    """
    every = in_parallel(lambda part: part(u), parts)
    found = tuple(prediction for prediction in every if prediction is not None)
    return found if len(found) == len(parts) else None
