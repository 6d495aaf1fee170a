"""The robot: backbone, routing, tendon and loads, as one module whose numbers are traced and whose structure
is static.
"""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .backbone import Backbone
from .mesh import Mesh, build_mesh, panel_index
from .problem import Sections
from .routing import Offset, Routing
from .terms import REGISTRY

STANDARD_GRAVITY = 9.80665


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


class Robot(eqx.Module):
    """A tendon-driven continuum manipulator, planar.

    Attributes:
        backbone, tendons, loads: physical parameters (traced).
        terms: numbers of every physics term, by term and name; at their null values none does anything.
        name: for reports (static).
        intervals: mesh intervals per panel (static).
        bore_kinks: which bore starts and ends lie inside the body (static).
        loaded: whether gravity or a tip force may act (static); without, the equilibrium is a single march.
    """

    backbone: Backbone
    tendons: tuple[Tendon, ...]
    loads: Loads
    terms: dict[str, dict[str, Float[Array, ""]]]
    name: str = eqx.field(static=True)
    intervals: tuple[int, ...] = eqx.field(static=True)
    bore_kinks: tuple[tuple[str, int], ...] = eqx.field(static=True)
    loaded: bool = eqx.field(static=True)

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
        """What `read` takes of each tendon, along a leading tendon axis; without it for one tendon."""
        if len(self.tendons) == 1:
            return read(self.tendons[0])
        return jnp.stack([read(tendon) for tendon in self.tendons])

    def with_values(self, **values) -> Robot:
        """The robot with named parameters replaced, e.g. `mu=0.3, E=1.2e6, r1=-0.01`, or with several
        tendons `**{"mu.left": 0.3}`; see `gtr_jax.parameters`. Concrete values out of bounds raise
        InputError; traced ones are taken as they are.
        """
        from .parameters import check_bounds, with_values

        check_bounds(self, values)
        return with_values(self, values)

    def value(self, name: str) -> Float[Array, ""]:
        """The named parameter's value in SI units."""
        from .parameters import value_of

        return value_of(self, name)


class Layout(eqx.Module):
    """Where the nodes lie with respect to what changes along the robot.

    Attributes:
        mesh: the nodes.
        passed: for each tendon, which kinks of its routing lie before each node, (kinks, N).
        bored: which bores each node lies in, (bores, N).
    """

    mesh: Mesh
    passed: tuple[Bool[Array, "_ N"], ...]
    bored: Bool[Array, "bores N"]


def inner_kinks(robot: Robot) -> Float[Array, " kinks"]:
    """Arc lengths [m] of the kinks of routings, bores and natural curvature, in this order, unsorted."""
    body = robot.backbone
    kinks = [tendon.routing.kinks() for tendon in robot.tendons]
    kinks += [getattr(body, field)[i][None] for field, i in robot.bore_kinks]
    if body.natural_curvature_s.shape[0] > 2:
        kinks.append(body.natural_curvature_s[1:-1])
    return jnp.clip(jnp.concatenate(kinks), 0.0, body.length)


def lay_out(robot: Robot) -> Layout:
    """Mesh and sides of the robot.

    A node's side of a kink is told by the order of the panels, not by comparing arc lengths, so that kinks
    that coincide (a bore that ends where the wave starts) stay consistent, and so do derivatives as they move
    through each other.
    """
    body = robot.backbone
    kinks = inner_kinks(robot)
    order = jnp.argsort(kinks)
    rank = jnp.argsort(order)
    mesh = build_mesh(jnp.concatenate([jnp.zeros(1), kinks[order], body.length[None]]), robot.intervals)
    behind = rank[:, None] < panel_index(robot.intervals)[None, :]
    passed, count = [], 0
    for tendon in robot.tendons:
        own = tendon.routing.kinks().shape[0]
        passed.append(behind[count : count + own])
        count += own
    where = {kink: behind[count + j] for j, kink in enumerate(robot.bore_kinks)}
    begun_at_base, ended_at_tip = jnp.ones(mesh.s.shape, bool), jnp.zeros(mesh.s.shape, bool)
    bored = [
        where.get(("bore_start", i), begun_at_base) & ~where.get(("bore_end", i), ended_at_tip)
        for i in range(body.bore_start.shape[0])
    ]
    return Layout(mesh, tuple(passed), jnp.stack(bored) if bored else jnp.zeros((0, *mesh.s.shape), bool))


def distal_mass(robot: Robot, at: Layout) -> Float[Array, " N"]:
    """Mass of the body distal to each node [kg]; exact for linear tapers (Simpson on each interval)."""
    body, mesh = robot.backbone, at.mesh
    start = mesh.s - mesh.interval.length
    ends = body.area(start, at.bored) + body.area(mesh.s, at.bored)
    volume = jnp.cumsum(mesh.interval.length / 6 * (ends + 4 * body.area(0.5 * (start + mesh.s), at.bored)))
    return body.density * (volume[-1] - volume)


def loads_of(robot: Robot) -> Loads:
    """The external loads, those of physics terms included."""
    loads = robot.loads
    for term in REGISTRY.values():
        loads = loads if term.loads is None else term.loads(robot.terms[term.id], loads)
    return loads


def sections(robot: Robot) -> Sections:
    """The robot evaluated at its nodes: all that the equilibrium needs."""
    at = lay_out(robot)
    mesh, body, loads = at.mesh, robot.backbone, loads_of(robot)
    mass = distal_mass(robot, at) + loads.payload
    gravity = loads.gravity * jnp.stack([jnp.cos(loads.gravity_angle), jnp.sin(loads.gravity_angle)])
    gravity = gravity + loads.more_gravity
    channels = [
        tendon.routing.offset(mesh.s, passed, body.length)
        for tendon, passed in zip(robot.tendons, at.passed, strict=True)
    ]
    return Sections(
        mesh=mesh,
        R=channels[0] if len(channels) == 1 else Offset(*map(jnp.stack, zip(*channels, strict=True))),
        compliance=body.compliance(mesh.s, at.bored),
        rest=body.curvature_at_rest(mesh.s),
        force_x=loads.tip_force[0] + mass * gravity[0],
        force_y=loads.tip_force[1] + mass * gravity[1],
    )
