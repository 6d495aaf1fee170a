"""The robot: backbone, routing, tendon and loads, as one module whose numbers are traced and whose structure is static."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .backbone import Backbone
from .mesh import Mesh, build_mesh
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
        """The robot with named parameters replaced, e.g. `mu=0.3, E=1.2e6, r1=-0.01`; see `gtr_jax.parameters`."""
        from .parameters import with_values

        return with_values(self, values)

    def value(self, name: str) -> Float[Array, ""]:
        """The named parameter's value in SI units."""
        from .parameters import value_of

        return value_of(self, name)


def panel_ends(robot: Robot) -> Float[Array, " ends"]:
    """Arc lengths [m] of base, kinks of routing, bores and natural curvature, and tip; increasing."""
    body = robot.backbone
    kinks = [robot.routing.kinks()]
    kinks += [getattr(body, field)[i][None] for field, i in robot.bore_kinks]
    if body.natural_curvature_s.shape[0] > 2:
        kinks.append(body.natural_curvature_s[1:-1])
    inner = jnp.sort(jnp.clip(jnp.concatenate(kinks), 0.0, body.length))
    return jnp.concatenate([jnp.zeros(1), inner, body.length[None]])


def mesh_of(robot: Robot) -> Mesh:
    """The robot's mesh."""
    return build_mesh(panel_ends(robot), robot.intervals)


def distal_weight(robot: Robot, mesh: Mesh) -> Float[Array, " N"]:
    """Weight of the body distal to each node [N]; exact for linear tapers (Simpson on each interval)."""
    body = robot.backbone
    start = mesh.s - mesh.length
    ends = body.area(start, mesh.side) + body.area(mesh.s, mesh.side)
    area = mesh.length / 6 * (ends + 4 * body.area(0.5 * (start + mesh.s), mesh.side))
    volume = jnp.cumsum(area)
    return robot.loads.gravity * body.density * (volume[-1] - volume)


def sections(robot: Robot) -> Sections:
    """The robot evaluated at its nodes: all that the equilibrium needs."""
    mesh = mesh_of(robot)
    body, loads = robot.backbone, robot.loads
    weight = distal_weight(robot, mesh)
    return Sections(
        mesh=mesh,
        R=robot.routing.offset(mesh.s, mesh.side, body.length),
        compliance=body.compliance(mesh.s, mesh.side),
        rest=body.curvature_at_rest(mesh.s),
        force_x=loads.tip_force[0] + weight * jnp.cos(loads.gravity_angle),
        force_y=loads.tip_force[1] + weight * jnp.sin(loads.gravity_angle),
    )
