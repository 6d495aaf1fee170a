"""The load history that a recording is simulated along, padded to one of the few compiled lengths."""

from __future__ import annotations

import dataclasses
import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gtr_jax import Robot, Simulation, simulate, true_base
from gtr_jax.simulation.history import cycles, padded_length

from .channels import Orientation

# Padded load histories kept in memory: a fit and a diagnosis reuse the same few.
HISTORIES = 64


class LoadHistory(eqx.Module):
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

    def driven_by(self, more: Float[Array, " tendons"]) -> LoadHistory:
        """A copy with what drives each tendon, a tension or a displacement, changed throughout."""
        more = more[0] if self.T_base.ndim == 1 else more[None]
        if self.displacement is None:
            return dataclasses.replace(self, T_base=self.T_base + more)
        # Of the two, a tendon reads the one that drives it.
        return dataclasses.replace(self, T_base=self.T_base + more, displacement=self.displacement + more)


def padded_history(
    T_base: np.ndarray,
    time: np.ndarray | None,
    trial: np.ndarray | None,
    length: int = 0,
    *,
    drawn: tuple[bool, ...] = (False,),
    orientation: Orientation | None = None,
) -> LoadHistory:
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
) -> LoadHistory:
    drive = np.frombuffer(T_base).reshape(-1, *tendons)
    clock = np.arange(len(drive), dtype=float) if time is None else np.frombuffer(time)
    missing = length - len(drive)
    last = clock[-1] - clock[-2] if len(clock) > 1 else 1.0
    done = np.zeros(0) if trial is None else np.unique(np.frombuffer(trial), return_inverse=True)[1]
    if not np.any(done):
        done = np.asarray(_cycles(jnp.asarray(drive)))
    return LoadHistory(
        T_base=jnp.asarray(np.concatenate([drive, np.broadcast_to(drive[-1], (missing, *tendons))])),
        time=jnp.asarray(np.concatenate([clock, clock[-1] + last * np.arange(1, missing + 1)])),
        cycle=jnp.asarray(np.concatenate([done, np.full(missing, done[-1])]), float),
    )


_cycles = eqx.filter_jit(cycles)


def simulation_along(robot: Robot, history: LoadHistory) -> Simulation:
    """The simulation of a load history."""
    T_base = true_base(robot, history.T_base, history.time)
    return simulate(robot, T_base, time=history.time, cycle=history.cycle, displacement=history.displacement)
