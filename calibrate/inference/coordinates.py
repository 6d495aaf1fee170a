"""The free parameters as coordinates near zero.

A positive parameter is value = reference exp(u), any other value = reference + scale u. Which parameters are
free is data, not structure: one compiled program serves every choice of the same number of parameters.
"""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from gtr_jax import InputError, Robot
from gtr_jax.robot.parameters import places_of

from .number import Number


class Coordinates(eqx.Module):
    """Where the p free parameters lie and how they are scaled.

    Attributes:
        index: places in the flattened robot, (p,); one past the end for a parameter that it does not have.
        reference: values at u = 0, SI, (p,).
        scale: value per unit of u where not logarithmic, SI, (p,).
        log: whether value = reference exp(u), (p,).
        lower, upper: bounds to which values that are not logarithmic are clipped, SI, (p,); infinite where
            open.
    """

    index: Int[Array, " p"]
    reference: Float[Array, " p"]
    scale: Float[Array, " p"]
    log: Bool[Array, " p"]
    lower: Float[Array, " p"]
    upper: Float[Array, " p"]

    def values(self, u: Float[ArrayLike, " p"]) -> Float[Array, " p"]:
        """SI values at the coordinates u."""
        u = jnp.asarray(u)
        growth = jnp.exp(jnp.where(self.log, u, 0.0))
        shifted = self.reference + self.scale * u
        bounded = jnp.where(shifted < self.lower, self.lower, shifted)
        bounded = jnp.where(bounded > self.upper, self.upper, bounded)
        return jnp.where(self.log, self.reference * growth, bounded)

    def robot_at(self, robot: Robot, u: Float[ArrayLike, " p"]) -> Robot:
        """The robot with its free parameters at the coordinates u."""
        flat, unravel = ravel_pytree(robot)
        return unravel(jnp.append(flat, 0.0).at[self.index].set(self.values(u))[:-1])

    def stopped(self, u: np.ndarray) -> np.ndarray:
        """Which values lie at their bounds, (p,) bool (host side)."""
        shifted = np.asarray(self.reference) + np.asarray(self.scale) * u
        outside = (shifted <= np.asarray(self.lower)) | (shifted >= np.asarray(self.upper))
        return ~np.asarray(self.log) & outside

    def at(self, values: Sequence[float] | np.ndarray) -> np.ndarray:
        """Coordinates of SI values (host side)."""
        values, reference = np.asarray(values, float), np.asarray(self.reference)
        log = np.asarray(self.log)
        ratio = np.where(log, values / np.where(log, reference, 1.0), 1.0)
        return np.where(log, np.log(ratio), (values - reference) / np.asarray(self.scale))


def places(robot: Robot, names: Sequence[str], has: Sequence[bool] | None = None) -> np.ndarray:
    """Where parameters lie in the flattened robot, (p,); one past the end for those that it does not have.

    Args:
        robot: whose parameters they are.
        names: of the parameters, p of them.
        has: which of them are parameters of this robot, (p,); all unless given.
    """
    own = np.ones(len(names), bool) if has is None else np.asarray(has, bool)
    index = np.full(len(names), ravel_pytree(robot)[0].shape[0])
    index[own] = np.asarray(places_of(robot, [n for n, mine in zip(names, own, strict=True) if mine]))
    return index


def coordinates(index: np.ndarray, numbers: Sequence[Number]) -> Coordinates:
    """Coordinates of numbers about their centres.

    Args:
        index: where they lie in the robot, (p,), from `places`.
        numbers: p of them.

    Raises:
        InputError: a positive number whose centre is zero has no logarithm.
    """
    for n in numbers:
        if n.log and n.centre <= 0:
            raise InputError(f"{n.key}: its start value is 0; give a positive one to fit it")
        if not np.isfinite(n.centre):
            raise InputError(f"{n.key}: its start value is infinite; give a number to fit it")
    return Coordinates(
        index=jnp.asarray(index),
        reference=jnp.asarray([n.centre for n in numbers], float),
        scale=jnp.asarray([abs(n.centre) if n.log else n.sd for n in numbers], float),
        log=jnp.asarray([n.log for n in numbers]),
        lower=jnp.asarray([n.lower for n in numbers]),
        upper=jnp.asarray([n.upper for n in numbers]),
    )
