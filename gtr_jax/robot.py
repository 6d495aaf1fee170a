"""The robot: backbone, routing, tendon and loads, as one module whose numbers are traced and whose structure
is static.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .backbone import Backbone
from .mesh import Mesh, build_mesh, panel_index
from .problem import Sections
from .routing import Routing

STANDARD_GRAVITY = 9.80665


class Tendon(eqx.Module):
    """Friction coefficient [-] and the uniform tension before the first load [N]."""

    friction_coefficient: Float[Array, ""]
    preload: Float[Array, ""]


class Loads(eqx.Module):
    """External loads, dead (fixed in direction).

    Attributes:
        gravity: acceleration [m/s^2]; 0 without gravity.
        gravity_angle: its direction in the bending plane from the base tangent [rad].
        tip_force: [N], shape (2,), along and across the base tangent.
        tip_moment: [N m], positive to the left.
    """

    gravity: Float[Array, ""]
    gravity_angle: Float[Array, ""]
    tip_force: Float[Array, "2"]
    tip_moment: Float[Array, ""]


class Robot(eqx.Module):
    """A tendon-driven continuum manipulator, planar.

    Attributes:
        backbone, routing, tendon, loads: physical parameters (traced).
        name: for reports (static).
        intervals: mesh intervals per panel (static).
        bore_kinks: which bore starts and ends lie inside the body (static).
        loaded: whether gravity or a tip force may act (static); without, the equilibrium is a single march.
    """

    backbone: Backbone
    routing: Routing
    tendon: Tendon
    loads: Loads
    name: str = eqx.field(static=True)
    intervals: tuple[int, ...] = eqx.field(static=True)
    bore_kinks: tuple[tuple[str, int], ...] = eqx.field(static=True)
    loaded: bool = eqx.field(static=True)

    def with_values(self, **values) -> Robot:
        """The robot with named parameters replaced, e.g. `mu=0.3, E=1.2e6, r1=-0.01`; see
        `gtr_jax.parameters`.
        """
        from .parameters import with_values

        return with_values(self, values)

    def value(self, name: str) -> Float[Array, ""]:
        """The named parameter's value in SI units."""
        from .parameters import value_of

        return value_of(self, name)


class Layout(eqx.Module):
    """Where the nodes lie with respect to what changes along the robot.

    Attributes:
        mesh: the nodes.
        passed: which kinks of the routing lie before each node, (kinks, N).
        bored: which bores each node lies in, (bores, N).
    """

    mesh: Mesh
    passed: Bool[Array, "kinks N"]
    bored: Bool[Array, "bores N"]


def inner_kinks(robot: Robot) -> Float[Array, " kinks"]:
    """Arc lengths [m] of the kinks of routing, bores and natural curvature, in this order, unsorted."""
    body = robot.backbone
    kinks = [robot.routing.kinks()]
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
    count = robot.routing.kinks().shape[0]
    where = {kink: behind[count + j] for j, kink in enumerate(robot.bore_kinks)}
    begun_at_base, ended_at_tip = jnp.ones(mesh.s.shape, bool), jnp.zeros(mesh.s.shape, bool)
    bored = [
        where.get(("bore_start", i), begun_at_base) & ~where.get(("bore_end", i), ended_at_tip)
        for i in range(body.bore_start.shape[0])
    ]
    return Layout(mesh, behind[:count], jnp.stack(bored) if bored else jnp.zeros((0, *mesh.s.shape), bool))


def distal_weight(robot: Robot, at: Layout) -> Float[Array, " N"]:
    """Weight of the body distal to each node [N]; exact for linear tapers (Simpson on each interval)."""
    body, mesh = robot.backbone, at.mesh
    start = mesh.s - mesh.interval.length
    ends = body.area(start, at.bored) + body.area(mesh.s, at.bored)
    volume = jnp.cumsum(mesh.interval.length / 6 * (ends + 4 * body.area(0.5 * (start + mesh.s), at.bored)))
    return robot.loads.gravity * body.density * (volume[-1] - volume)


def sections(robot: Robot) -> Sections:
    """The robot evaluated at its nodes: all that the equilibrium needs."""
    at = lay_out(robot)
    mesh, body, loads = at.mesh, robot.backbone, robot.loads
    weight = distal_weight(robot, at)
    return Sections(
        mesh=mesh,
        R=robot.routing.offset(mesh.s, at.passed, body.length),
        compliance=body.compliance(mesh.s, at.bored),
        rest=body.curvature_at_rest(mesh.s),
        force_x=loads.tip_force[0] + weight * jnp.cos(loads.gravity_angle),
        force_y=loads.tip_force[1] + weight * jnp.sin(loads.gravity_angle),
    )
