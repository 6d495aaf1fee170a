"""Simulated readings of a recording with derivatives, from programs that JAX has compiled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gtr_jax import Robot, Simulation, reading
from gtr_jax.robot.parts import Tendon
from gtr_jax.simulation.markers import marker_readings
from gtr_jax.stored import Stored

from .channel_rows import channel_rows, shows_markers
from .channels import CHANNELS, Orientation, of_tendons, turned_by
from .coordinates import Coordinates
from .load_history import LoadHistory, padded_history, simulation_along
from .simulated_readings import Prediction

# Step of differences, in coordinates and as a share of the range of what drives a tendon.
STEP = 1e-4


def shown(
    robot: Robot, history: LoadHistory, channels: Sequence[str] = CHANNELS
) -> tuple[Float[Array, "C P"], Simulation]:
    """What the instruments show of a load history on some channels, SI, and the simulation."""
    run = simulation_along(robot, history)
    turned = None if history.orientation is None else turned_by(run.tip_rotation, history.orientation)
    markers = marker_readings(robot, run) if shows_markers(robot, channels) else None
    seen = reading(robot, run)
    rows = channel_rows(
        robot,
        channels,
        place=run.tip_position,
        angle=run.tip_pose[:, 2],
        turned=turned,
        markers=markers,
        ends={"T_tip": seen.T_tip, "T_base": seen.T_base, "displacement": run.displacement},
    )
    return jnp.stack(rows), run


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
    robot: Robot, at: Coordinates, history: LoadHistory, u: Float[Array, " p"], channels: tuple[str, ...]
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
    history: LoadHistory,
    u: Float[Array, " p"],
    more: Float[Array, " tendons"],
    channels: tuple[str, ...],
) -> tuple[Array, ...]:
    """As `_predict`, without derivatives, with what drives the tendons changed throughout."""
    values, run = shown(at.robot_at(robot, u), history.driven_by(more), channels)
    return values, run.solved, run.slip_front, run.slip_direction


def _by_differences(
    robot: Robot, at: Coordinates, history: LoadHistory, u: np.ndarray, channels: tuple[str, ...]
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

    def many(self, many: Sequence[np.ndarray]) -> list[Prediction | None]:
        """The recording at several coordinates, (p,) each, one after the other."""
        return [self(u) for u in many]

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
        return Prediction(
            values=values,
            T_tip=T_tip,
            failed=int(np.sum(~np.asarray(converged)[: self.steps])),
            slips=whole[self._next],
            direction=np.asarray(direction)[self._next],
            jacobian=slopes[..., : len(u)],
            slopes=tuple(np.moveaxis(slopes[..., len(u) :], -1, 0)),
        )

    def _anchored(self, tendon: Tendon) -> Float[Array, ""]:
        """Arc length at which a tendon ends [m]."""
        return self.robot.backbone.length if tendon.to is None else tendon.to
