"""Tendons, loads and the body: what a robot is made of. Its numbers are traced, its structure is static."""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .backbone import Backbone
from .routing import Routing


class Tendon(eqx.Module):
    """One tendon in its channel.

    Attributes:
        routing: the channel.
        friction_coefficient: of tendon and channel [-].
        preload: uniform tension before the first load [N].
        name: tells several tendons apart (static); "" for the only one.
    """

    routing: Routing
    friction_coefficient: Float[Array, ""]
    preload: Float[Array, ""]
    name: str = eqx.field(static=True, default="")


class Loads(eqx.Module):
    """External loads, dead (fixed in direction).

    Attributes:
        gravity: acceleration [m/s^2]; 0 without gravity.
        gravity_angle: its direction in the bending plane from the base tangent [rad].
        more_gravity: acceleration added to it [m/s^2], shape (2,), along and across the base tangent.
        tip_force: [N], shape (2,), along and across the base tangent.
        tip_moment: [N m], positive to the left.
        payload: mass at the tip [kg].
    """

    gravity: Float[Array, ""]
    gravity_angle: Float[Array, ""]
    more_gravity: Float[Array, "2"]
    tip_force: Float[Array, "2"]
    tip_moment: Float[Array, ""]
    payload: Float[Array, ""]


class Parts(eqx.Module):
    """All that a robot is made of; `Robot` adds its parameters by name.

    Attributes:
        backbone, tendons, loads: physical parameters (traced).
        terms: numbers of every physics term, by term and name; at its null values a term has no effect.
        name: for reports (static).
        intervals: mesh intervals per panel (static).
        bore_kinks: which bore starts and ends lie inside the body (static).
        loaded: whether gravity or a tip force may act (static); without, the equilibrium is a single march.
        acting: names of the physics terms that may act, in the order of the registry, without those of the
            load cells, which always do (static): those that act in the robot file, and those whose size
            `with_values` has set, to any value. Where their numbers are traced, a program contains these
            terms only.
    """

    backbone: Backbone
    tendons: tuple[Tendon, ...]
    loads: Loads
    terms: dict[str, dict[str, Float[Array, ""]]]
    name: str = eqx.field(static=True)
    intervals: tuple[int, ...] = eqx.field(static=True)
    bore_kinks: tuple[tuple[str, int], ...] = eqx.field(static=True)
    loaded: bool = eqx.field(static=True)
    acting: tuple[str, ...] = eqx.field(static=True)

    @property
    def tendon(self) -> Tendon:
        """The tendon of a robot that has one; ValueError if it has several."""
        if len(self.tendons) != 1:
            raise ValueError(f"{self.name} has {len(self.tendons)} tendons; take one of robot.tendons")
        return self.tendons[0]

    @property
    def routing(self) -> Routing:
        """The channel of a robot that has one tendon; ValueError if it has several."""
        return self.tendon.routing

    @property
    def tendon_names(self) -> tuple[str, ...]:
        """Names of the tendons in the order of the tendon axis; empty for one tendon, which has no axis."""
        return tuple(tendon.name for tendon in self.tendons) if len(self.tendons) > 1 else ()

    def per_tendon(self, read: Callable[[Tendon], Array]) -> Array:
        """What `read` returns for each tendon, along a leading tendon axis; no such axis for one tendon."""
        if len(self.tendons) == 1:
            return read(self.tendons[0])
        return jnp.stack([read(tendon) for tendon in self.tendons])
