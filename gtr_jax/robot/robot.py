"""The robot: backbone, tendons and loads as one module, and what the mechanics needs to know of it."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import Array, Bool, Float

from gtr_jax.mechanics.offset import Offset, SpatialOffset

from ..mechanics.guides import Guides, guides_of
from ..mechanics.mesh import Mesh, build_mesh, panel_index
from ..mechanics.sections import Closing, Sections
from ..notebook import as_card
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

    _repr_html_ = as_card

    def value(self, name: str) -> Float[Array, ""]:
        """The named parameter's value in SI units."""
        return value_of(self, name)


class Layout(eqx.Module):
    """Where the nodes lie relative to the kinks and bores along the robot.

    Attributes:
        mesh: the nodes.
        passed: for each tendon, which kinks of its routing lie before each node, (kinks, N).
        bored: which bores, then which pieces of the body and which notches each node lies in, (bores +
            pieces + notches, N).
        beyond: which nodes lie past the end of each tendon, (tendons, N).
        guides: which guides of each tendon lie before each node, (guides, N).
    """

    mesh: Mesh
    passed: tuple[Bool[Array, "_ N"], ...]
    bored: Bool[Array, "stretches N"]
    beyond: Bool[Array, "tendons N"]
    guides: tuple[Bool[Array, "_ N"], ...]


def inner_kinks(robot: Robot) -> Float[Array, " kinks"]:
    """Arc lengths [m] of the kinks of routings, of bores and pieces of the body, of the ends and the guides
    of tendons, and of the body's natural strain and stiffness, in this order, unsorted.
    """
    body = robot.backbone
    kinks = [tendon.routing.kinks() for tendon in robot.tendons]
    kinks += [getattr(body, field)[i][None] for field, i in robot.bore_kinks]
    kinks += [tendon.to[None] for tendon in robot.tendons if tendon.to is not None]
    kinks += [tendon.guides for tendon in robot.tendons if tendon.guides is not None]
    kinks += body.kinks()
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
    ends = jnp.concatenate([jnp.zeros(1), kinks[order], body.length[None]])
    mesh = build_mesh(ends, robot.intervals, with_rates=robot.space)
    behind = rank[:, None] < panel_index(robot.intervals)[None, :]
    passed, count = [], 0
    for tendon in robot.tendons:
        own = tendon.routing.kinks().shape[0]
        passed.append(behind[count : count + own])
        count += own
    where = {kink: behind[count + j] for j, kink in enumerate(robot.bore_kinks)}
    begun_at_base, ended_at_tip = jnp.ones(mesh.s.shape, bool), jnp.zeros(mesh.s.shape, bool)
    bored = [
        where.get((f"{kind}_start", i), begun_at_base) & ~where.get((f"{kind}_end", i), ended_at_tip)
        for kind, count in (
            ("bore", body.bore_start.shape[0]),
            ("piece", len(body.pieces)),
            ("notch", body.notch_start.shape[0]),
        )
        for i in range(count)
    ]
    count += len(robot.bore_kinks)
    beyond, guides = [], []
    for tendon in robot.tendons:
        beyond.append(ended_at_tip if tendon.to is None else behind[count])
        count += tendon.to is not None
    for tendon in robot.tendons:
        own = 0 if tendon.guides is None else tendon.guides.shape[0]
        guides.append(behind[count : count + own])
        count += own
    none = jnp.zeros((0, *mesh.s.shape), bool)
    return Layout(mesh, tuple(passed), jnp.stack(bored) if bored else none, jnp.stack(beyond), tuple(guides))


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
    for term in robot.catalogue.values():
        loads = loads if term.loads is None else term.loads(robot.terms[term.id], loads)
    return loads


def from_base(robot: Robot, vector: Float[Array, "3"]) -> Float[Array, "3"]:
    """A vector given in the axes of the world, in those of the base."""
    return jnp.sum(robot.base.rotation * vector[:, None], axis=0)


def tip_moment_of(robot: Robot) -> Float[Array, "*moments"]:
    """External moment at the tip [N m], in space in the axes of the base."""
    moment = robot.loads.tip_moment
    return from_base(robot, moment) if robot.space else moment


def sections(robot: Robot) -> Sections:
    """The robot evaluated at its nodes: all that the equilibrium needs."""
    return _in_space(robot) if robot.space else _in_plane(robot)


def _in_space(robot: Robot) -> Sections:
    at = lay_out(robot)
    mesh, body, loads = at.mesh, robot.backbone, loads_of(robot)
    mass = distal_mass(robot, at) + loads.payload
    gravity, tip_force = (from_base(robot, v) for v in (loads.gravity_vector(), loads.tip_force))
    channels = [
        _until(tendon.routing.section_offset(mesh.s, passed, body.length), beyond)
        for tendon, passed, beyond in zip(robot.tendons, at.passed, at.beyond, strict=True)
    ]
    anchored = any(tendon.to is not None for tendon in robot.tendons)
    return Sections(
        mesh=mesh,
        R=channels[0] if len(channels) == 1 else SpatialOffset(*map(jnp.stack, zip(*channels, strict=True))),
        compliance=body.compliances(mesh.s, at.bored),
        rest=body.strain_at_rest(mesh.s),
        force=tuple(tip_force[i] + mass * gravity[i] for i in range(3)),
        beyond=(at.beyond if len(channels) > 1 else at.beyond[0]) if anchored else None,
        guides=_guides(robot, at),
        reach=body.reach(mesh.s, at.bored),
    )


def _guides(robot: Robot, at: Layout) -> Guides | None:
    """The guides of the tendons; None if none is guided."""
    if all(tendon.guides is None for tendon in robot.tendons):
        return None
    segments = 1 + max(passed.shape[0] for passed in at.guides)
    each = [
        guides_of(None if tendon.guides is None else passed, beyond, at.mesh.s, segments)
        for tendon, passed, beyond in zip(robot.tendons, at.guides, at.beyond, strict=True)
    ]
    return each[0] if len(each) == 1 else jtu.tree_map(lambda *a: jnp.stack(a), *each)


def _until(offset: SpatialOffset, beyond: Bool[Array, " N"]) -> SpatialOffset:
    """The offset of a channel, zero past the anchor of its tendon."""
    return SpatialOffset(*(jnp.where(beyond[:, None], 0.0, part) for part in offset))


def _in_plane(robot: Robot) -> Sections:
    at = lay_out(robot)
    mesh, body, loads = at.mesh, robot.backbone, loads_of(robot)
    mass = distal_mass(robot, at) + loads.payload
    gravity = loads.gravity * jnp.stack([jnp.cos(loads.gravity_angle), jnp.sin(loads.gravity_angle)])
    gravity = gravity + loads.more_gravity
    channels = [
        tendon.routing.offset(mesh.s, passed, body.length)
        for tendon, passed in zip(robot.tendons, at.passed, strict=True)
    ]
    rest, shift, closing = body.curvature_at_rest(mesh.s), None, None
    cut = body.cut(mesh.s, at.bored)
    if cut is not None:
        # The body bends about its neutral line; channels and the axis lie beside it.
        shift = jnp.where(cut.within, cut.side * cut.section.centroid, 0.0)
        channels = [channel._replace(value=channel.value + shift) for channel in channels]
        rest = rest + cut.natural
        closing = Closing(cut.side, cut.limit, body.closed_stiffness(mesh.s, at.bored))
    return Sections(
        mesh=mesh,
        R=channels[0] if len(channels) == 1 else Offset(*map(jnp.stack, zip(*channels, strict=True))),
        compliance=body.compliance(mesh.s, at.bored),
        rest=rest,
        force=tuple(loads.tip_force[i] + mass * gravity[i] for i in range(2)),
        reach=body.reach(mesh.s, at.bored),
        shift=shift,
        closing=closing,
    )
