"""The arrays that a solved equilibrium and a load history are made of, and what is read off them alone."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, Int

from ..mechanics import Memory
from .outcome import WithResult
from .sensing import Reading
from .shape import Pose, Shape, tip_position, tip_rotation


class EquilibriumArrays(eqx.Module, WithResult):
    """What `Equilibrium` holds, and says of each array."""

    s: Float[Array, " N"]
    curvature: Float[Array, " N"]
    angle: Float[Array, " N"]
    tension: Float[Array, "*tendons N"]
    T_tip: Float[Array, "*tendons"]
    slip: Float[Array, "*tendons N"]
    external_moment: Float[Array, "N *moment"]
    x: Float[Array, " N"]
    y: Float[Array, " N"]
    wrap: Float[Array, "*tendons N"]
    tendon_angle: Float[Array, "*tendons N"]
    metric: Float[Array, "*tendons N"]
    R: Float[Array, "*tendons_N"]
    tendon_length: Float[Array, "*tendons"]
    mobilisation: Float[Array, "tendons N"] | None
    result: optx.RESULTS
    residual_norm: Float[Array, ""]
    iterations: Int[Array, ""]
    memory: Memory | None = None
    shape: Shape | None = None

    @property
    def tip(self) -> Pose:
        """Where the tip is and how it is turned, in the plane and in space."""
        return Pose(self.tip_position, self.tip_rotation)

    @property
    def tip_pose(self) -> Float[Array, "*batch 3"]:
        """Midline tip of a robot in the plane: x [m], y [m], angle [rad]. In space these are of its
        projection on the plane of x and y, and no position: take `tip`.
        """
        return jnp.stack([self.x[..., -1], self.y[..., -1], self.angle[..., -1]], axis=-1)

    @property
    def tip_position(self) -> Float[Array, "*batch 3"]:
        """Midline tip in the world [m]; z = 0 in the plane."""
        return tip_position(self.shape, self.tip_pose)

    @property
    def tip_rotation(self) -> Float[Array, "*batch 3 3"]:
        """The directors of the tip as columns, in the axes of the world."""
        return tip_rotation(self.shape, self.tip_pose)


class SimulationArrays(eqx.Module, WithResult):
    """What `Simulation` holds, and says of each array."""

    T_base: Float[Array, "K *tendons"]
    time: Float[Array, " K"]
    T_tip: Float[Array, "K *tendons"]
    reading: Reading
    tip_pose: Float[Array, "K 3"]
    displacement: Float[Array, "K *tendons"]
    slip_direction: Float[Array, "K *tendons"]
    slip_front: Float[Array, "K *tendons"]
    s: Float[Array, " N"]
    tension: Float[Array, "K *tendons N"]
    slip: Float[Array, "K *tendons N"]
    curvature: Float[Array, "K N"]
    angle: Float[Array, "K N"]
    external_moment: Float[Array, "K N *moment"]
    mobilisation: Float[Array, "K tendons N"] | None
    result: optx.RESULTS
    residual_norm: Float[Array, " K"]
    iterations: Int[Array, " K"]
    shape: Shape | None = None

    @property
    def tip(self) -> Pose:
        """Where the tip is and how it is turned in each step, in the plane and in space."""
        return Pose(self.tip_position, self.tip_rotation)

    @property
    def tip_position(self) -> Float[Array, "K 3"]:
        """Midline tip in the world [m], (K, 3); z = 0 in the plane."""
        return tip_position(self.shape, self.tip_pose)

    @property
    def tip_rotation(self) -> Float[Array, "K 3 3"]:
        """The directors of the tip as columns, in the axes of the world, (K, 3, 3)."""
        return tip_rotation(self.shape, self.tip_pose)

    @property
    def slip_speed(self) -> Float[Array, "K *tendons N"]:
        """Speed of the slip towards the base in each step [m/s], (K, *tendons, N); zero in the first."""
        dt = jnp.diff(self.time, prepend=self.time[:1])
        rate = 1.0 / jnp.where(dt > 0, dt, jnp.inf)
        change = jnp.diff(self.slip, axis=0, prepend=self.slip[:1])
        return change * rate.reshape(-1, *[1] * (change.ndim - 1))
