"""Tendons, loads, base, markers and the body: what a robot is made of. Its numbers are traced, its structure
is static.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from gtr_jax.terms import Law, Term, catalogue_of

from .backbone import Backbone
from .rotation import rotation_of
from .routing import Routing


class Tendon(eqx.Module):
    """One tendon in its channel.

    Attributes:
        routing: the channel.
        friction_coefficient: of tendon and channel [-].
        preload: uniform tension before the first load [N].
        name: tells several tendons apart (static); "" for the only one.
        drive: what moves its end at the base, "tension" or "displacement" (static).
        to: arc length at which it is anchored [m]; None: the tip.
        guides: arc lengths of the disks that guide it [m], increasing, (guides,); straight between them.
            None: a channel all along.
        axial_stiffness: EA [N]; infinite if it does not stretch.
        free_length: of the tendon between the motor and the base [m], where it stretches too.

    The last five have an effect in space only; in the plane the last two may be None.
    """

    routing: Routing
    friction_coefficient: Float[Array, ""]
    preload: Float[Array, ""]
    name: str = eqx.field(static=True, default="")
    drive: str = eqx.field(static=True, default="tension")
    to: Float[Array, ""] | None = None
    guides: Float[Array, " guides"] | None = None
    axial_stiffness: Float[Array, ""] | None = None
    free_length: Float[Array, ""] | None = None


class Loads(eqx.Module):
    """External loads, dead (fixed in direction), in the axes of the world: x along the straight body unless
    the base is turned, y to its left. In the plane vectors have two entries and the moment is a number; in
    space all have three.

    Attributes:
        gravity: acceleration [m/s^2]; 0 without gravity.
        gravity_angle: its direction in the plane of x and y, from x [rad].
        more_gravity: acceleration added to it [m/s^2], (axes,).
        tip_force: [N], (axes,).
        tip_moment: [N m], (3,), or () about z, positive to the left.
        payload: mass at the tip [kg].
    """

    gravity: Float[Array, ""]
    gravity_angle: Float[Array, ""]
    more_gravity: Float[Array, " axes"]
    tip_force: Float[Array, " axes"]
    tip_moment: Float[Array, "*moments"]
    payload: Float[Array, ""]

    def gravity_vector(self) -> Float[Array, "3"]:
        """The acceleration of gravity [m/s^2], (3,)."""
        angle = self.gravity_angle
        in_plane = self.gravity * jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros(())])
        return in_plane + jnp.pad(self.more_gravity, (0, 3 - self.more_gravity.shape[0]))


class Base(eqx.Module):
    """Where the base stands in the world.

    Attributes:
        position: [m], (3,).
        rotation_vector: the axis by which it is turned, as long as the angle [rad], (3,).
    """

    position: Float[Array, "3"]
    rotation_vector: Float[Array, "3"]

    @property
    def rotation(self) -> Float[Array, "3 3"]:
        """The directors of the base as columns, in the axes of the world."""
        return rotation_of(self.rotation_vector)


class Marker(eqx.Module):
    """A point fixed to a section of the body.

    Attributes:
        at: arc length [m].
        offset: from the midline, along the body, to its left and across the plane [m], (3,).
        angle_from: arc length of the section from which the angle of its own is counted [m].
        name: with which its columns begin (static).
    """

    at: Float[Array, ""]
    offset: Float[Array, "3"]
    angle_from: Float[Array, ""]
    name: str = eqx.field(static=True)


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
        base: where the base stands in the world; the plane's is at the origin, unturned.
        markers: points of the body that are recorded.
        space: whether it may leave its plane (static).
        laws: physics terms that its file states as expressions (static).
    """

    backbone: Backbone
    tendons: tuple[Tendon, ...]
    loads: Loads
    terms: dict[str, dict[str, Float[Array, "*each"]]]
    name: str = eqx.field(static=True)
    intervals: tuple[int, ...] = eqx.field(static=True)
    bore_kinks: tuple[tuple[str, int], ...] = eqx.field(static=True)
    loaded: bool = eqx.field(static=True)
    acting: tuple[str, ...] = eqx.field(static=True)
    base: Base = eqx.field(default_factory=lambda: Base(jnp.zeros(3), jnp.zeros(3)))
    markers: tuple[Marker, ...] = ()
    space: bool = eqx.field(static=True, default=False)
    laws: tuple[Law, ...] = eqx.field(static=True, default=())

    @property
    def catalogue(self) -> Mapping[str, Term]:
        """Every physics term it may have, by name: the laws of its file and the registered ones."""
        return catalogue_of(self.laws)

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
