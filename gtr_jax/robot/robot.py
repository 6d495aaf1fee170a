"""The robot: backbone, tendons and loads as one module, and what the mechanics needs to know of it."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gtr_jax.mechanics.offset import Offset
from gtr_jax.terms import REGISTRY

from ..mechanics.mesh import Mesh, build_mesh, panel_index
from ..mechanics.sections import Sections
from .parameters import check_bounds, value_of, with_values
from .parts import Loads, Parts

STANDARD_GRAVITY = 9.80665  # m/s^2


class Robot(Parts):
    """A tendon-driven continuum manipulator, planar; its attributes are those of `Parts`."""

    def with_values(self, **values) -> Robot:
        """The robot with named parameters replaced, e.g. `mu=0.3, E=1.2e6, r1=-0.01`, or with several
        tendons `**{"mu.left": 0.3}`; see `gtr_jax.robot.parameters`. Concrete values out of bounds raise
        InputError; traced ones are taken as they are. A physics term whose size is named joins `acting`.
        """
        check_bounds(self, values)
        return with_values(self, values)

    def for_any_terms(self) -> Robot:
        """The same without the names of what may act, for programs whose structure is decided: one compiled
        program then serves robots of which other terms may act.
        """
        return dataclasses.replace(self, acting=())

    def value(self, name: str) -> Float[Array, ""]:
        """The named parameter's value in SI units."""
        return value_of(self, name)


class Layout(eqx.Module):
    """Where the nodes lie relative to the kinks and bores along the robot.

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
    """The mesh of a robot, and on which side of each kink its nodes lie.

    A node's side of a kink is determined by the order of the panels, not by comparing arc lengths, so that
    kinks that coincide (a bore that ends where the wave starts) stay consistent, and so do derivatives as
    they move through each other.
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
