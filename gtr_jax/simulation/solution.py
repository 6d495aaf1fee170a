"""The solution of one equilibrium, and the quantities computed from its state."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ..mechanics import Memory, ProgramSpec, Step, Unloaded, channel, metric_of
from ..mechanics.bodies import line_of, offset_of
from ..mechanics.mesh import cumulative, increments
from ..mechanics.offset import SpatialOffset
from ..mechanics.sections import Sections, State, at_tendons
from ..mechanics.space import SPACE
from ..robot.parts import Base, Tendon
from ..terms import REGISTRY, called
from ..terms.term import Values
from .arrays import EquilibriumArrays
from .outcome import outcome
from .shape import Shape
from .tables import equilibrium_dataset

if TYPE_CHECKING:
    import xarray

    from ..robot.robot import Robot


class Equilibrium(EquilibriumArrays):
    """Solution of one equilibrium, SI units; N nodes from base to tip; panel ends appear twice. May carry
    batch axes in front. Quantities of a tendon have a tendon axis where the robot has several tendons.

    Attributes:
        s: arc length of the nodes, (N,).
        curvature, angle: of the midline, (N,). In space, the size of its curvature, and the angle of its
            projection on the plane of x and y.
        tension: of the tendon, (*tendons, N).
        T_tip: tension at the tip's anchor, past any friction lumped there, (*tendons,).
        slip: of the tendon towards the base, since the robot settled with slack tendons, (*tendons, N).
        external_moment: moment of the external loads, (N,); in space (N, 3), in the axes of the base.
        x, y: midline, (N,).
        wrap: total turning of the tendon since the base, (*tendons, N).
        tendon_angle: psi of the tendon's tangent from the x axis [rad], (*tendons, N); in space that of its
            projection on the plane of x and y.
        metric: nu = ds_c/ds of the channel, (*tendons, N).
        R: channel offset, (*tendons, N); in space (*tendons, N, 2).
        tendon_length: length of the channel, (*tendons,).
        mobilisation: of friction between each node and the one before it, +1 slipping towards the base, -1
            towards the tip, between where locked, (tendons, N); None for one tendon.
        result: optimistix result; compare with `optimistix.RESULTS.successful`. `outside_physics` where
            the numbers are of no robot.
        residual_norm: dimensionless, see `problem.residual_norm`; ().
        iterations: marches taken, ().
        memory: what physics terms remember, for the next equilibrium; None if read off a simulation.
        shape: of a robot in space; None in the plane.
    """

    def to_xarray(self, robot: Robot | None = None) -> xarray.Dataset:
        """The equilibrium as a dataset with labels and units, along the tendons (tendon, s), the body (s);
        as `Simulation.to_xarray`.
        """
        return equilibrium_dataset(self, robot)

    def of_tendon(self, index: int) -> Equilibrium:
        """This solution for one of several tendons, without the tendon axis."""
        own = ("tension", "T_tip", "slip", "wrap", "tendon_angle", "metric", "R", "tendon_length")
        taken = {name: getattr(self, name)[index] for name in own}
        return dataclasses.replace(self, **taken, mobilisation=None, memory=None)


def tendon_length(s: Sections, y: State) -> Float[Array, "*tendons"]:
    """Length of the channels from base to tip [m], (*tendons,)."""

    def length(metric):
        return jnp.sum(increments(s.mesh.weights, metric))

    metric = metric_of(s, y.kappa)
    return length(metric) if metric.ndim == 1 else jax.vmap(length)(metric)


def slip_without_stretch(s: Sections, settled: State, y: State) -> Float[Array, "*tendons N"]:
    """Slip of the tendons towards the base since the robot settled [m], if they do not stretch."""

    def beyond(shortened):
        drawn = cumulative(s.mesh.weights, shortened)
        return drawn[-1] - drawn

    shortened = metric_of(s, settled.kappa) - metric_of(s, y.kappa)
    return beyond(shortened) if shortened.ndim == 1 else jax.vmap(beyond)(shortened)


def drawn_out(
    terms: Mapping[str, Values],
    slip: Float[Array, "*at"],
    T_base: Float[Array, "*at"],
    preload: Float[Array, "*any"],
) -> Float[Array, "*at"]:
    """Tendon drawn out at the base since it was strung [m]: its slip into the channel, and what it has
    stretched ahead of it.

    Args:
        terms: numbers of the physics terms, by term and name.
        slip: of the tendon at the base [m].
        T_base: base tension [N].
        preload: base tension when it was strung [N].
    """
    for term in REGISTRY.values():
        if term.ahead is not None:
            values = terms[term.id]
            strung = called(term.ahead, values, jnp.broadcast_to(preload, T_base.shape))
            slip = slip + called(term.ahead, values, T_base) - strung
    return slip


def stretch_of(
    tendons: Sequence[Tendon],
    s: Float[Array, " N"],
    tension: Float[Array, "*tendons N"],
    metric: Float[Array, "*tendons N"],
) -> Float[Array, "*tendons"]:
    """How much longer the tendons are than at their preloads, by their own stretch, along the channel and
    between motor and base [m]; zero of those without an axial stiffness.

    Args:
        tendons: of the robot.
        s: nodes [m].
        tension: of the tendons [N].
        metric: ds_c/ds of the channels.
    """
    several = len(tendons) > 1
    found = []
    for i, tendon in enumerate(tendons):
        if tendon.axial_stiffness is None or tendon.free_length is None:
            found.append(jnp.zeros(()))
            continue
        more, nu = (tension[i], metric[i]) if several else (tension, metric)
        within = jnp.sum(_tightening(tendon, s, more, nu))
        found.append((within + (more[0] - tendon.preload) * tendon.free_length) / tendon.axial_stiffness)
    return jnp.stack(found) if several else found[0]


def stretch_beyond(
    tendons: Sequence[Tendon],
    s: Float[Array, " N"],
    tension: Float[Array, "*tendons N"],
    metric: Float[Array, "*tendons N"],
) -> Float[Array, "*tendons N"]:
    """How much longer than at their preloads the tendons are beyond each node, by their own stretch in the
    channel [m]; zero of those without an axial stiffness. Arguments as of `stretch_of`.
    """

    def beyond(tendon, tension, metric):
        if tendon.axial_stiffness is None:
            return jnp.zeros_like(s)
        gone = jnp.cumsum(_tightening(tendon, s, tension, metric))
        return (gone[-1] - jnp.concatenate([jnp.zeros(1), gone])) / tendon.axial_stiffness

    if len(tendons) == 1:
        return beyond(tendons[0], tension, metric)
    return jnp.stack([beyond(*own) for own in zip(tendons, tension, metric, strict=True)])


def _tightening(
    tendon: Tendon, s: Float[Array, " N"], tension: Float[Array, " N"], metric: Float[Array, " N"]
) -> Float[Array, " M"]:
    """Integral of the tension over the preload along each interval of the channel [N m]."""
    along = (tension - tendon.preload) * metric
    return 0.5 * (along[1:] + along[:-1]) * jnp.diff(s)


class Loaded(eqx.Module):
    """A solved load step: the state, the tendons, and the outcome of the solver; attributes as in
    `Equilibrium`.
    """

    state: State
    tension: Float[Array, "*tendons N"]
    T_tip: Float[Array, "*tendons"]
    slip: Float[Array, "*tendons N"]
    wrap: Float[Array, "*tendons N"]
    mobilisation: Float[Array, "tendons N"] | None
    result: optx.RESULTS
    residual_norm: Float[Array, ""]
    iterations: Int[Array, ""]

    @property
    def converged(self) -> Bool[Array, ""]:
        """Whether everything met its tolerance."""
        return self.result == optx.RESULTS.successful


def loaded_of(s: Sections, structure: ProgramSpec, settled: Unloaded, done: Step) -> Loaded:
    """A solved load step with nodes along the last axis; in the base model, slip is without stretch."""

    def nodes_last(values):
        return jnp.moveaxis(values, 0, -1)

    wrap = s.to_anchor(nodes_last(jnp.cumsum(done.state.wrap, axis=0)))
    tension = nodes_last(done.tension)
    held = s.to_anchor(tension)
    T_tip = done.T_tip
    if s.beyond is not None:  # what is lumped at the tip is at the anchor
        end = tension[..., -1]
        T_tip = held[..., -1] * jnp.where(end > 0, T_tip / jnp.where(end > 0, end, 1.0), 1.0)
    if done.slip is None:
        slipped = slip_without_stretch(s, dataclasses.replace(done.state, kappa=settled.kappa), done.state)
    else:
        slipped = nodes_last(done.slip)
    several = done.mobilised is not None and bool(structure.tendons)
    return Loaded(
        state=dataclasses.replace(done.state, wrap=wrap),
        tension=held,
        T_tip=T_tip,
        slip=slipped,
        wrap=wrap,
        mobilisation=nodes_last(done.mobilised) if several else None,
        result=optx.RESULTS.where(
            done.met, optx.RESULTS.successful, optx.RESULTS.nonlinear_max_steps_reached
        ),
        residual_norm=done.error,
        iterations=done.marches,
    )


def _shape(s: Sections, base: Base, y: State) -> Shape:
    """The shape in the world of a body in space."""
    turn = base.rotation
    place = jnp.stack(line_of(s, y.phi, y.kappa), axis=-1)
    rotation = jnp.einsum("ij,njk->nik", turn, y.phi)
    position = base.position[None, :] + jnp.einsum("ij,nj->ni", turn, place)
    stretch = y.kappa[:, 3] if y.kappa.shape[-1] == 4 else None
    return Shape(y.kappa[:, :3], rotation, position, stretch)


def _from_axis(s: Sections, R: Float[Array, "*any"]) -> Float[Array, "*any"]:
    """Offsets from the axis, of those from the neutral line."""
    return R if s.shift is None else R - jnp.broadcast_to(s.shift, R.shape)


def _bending(strain: Float[Array, "N strains"]) -> Float[Array, " N"]:
    """Size of the curvature, with derivative 0 where the body is straight."""
    square = strain[:, 1] ** 2 + strain[:, 2] ** 2
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


def _projected(direction: Float[Array, "*any 3"]) -> Float[Array, "*any"]:
    """Angle from the x axis of the projection on the plane of x and y [rad]."""
    return jnp.arctan2(direction[..., 1], direction[..., 0])


def _seen(s: Sections, y: State, shape: Shape | None):
    """Curvature, angle, x, y of the midline and the angle of the tendons' tangent."""
    if shape is None:
        tangent = at_tendons(y.phi, s.R) + channel.tangent_lead(at_tendons(y.kappa, s.R), s.R)
        x, across = line_of(s, y.phi, y.kappa)
        return y.kappa, y.phi, x, across, tangent
    course = SPACE.course(y.kappa, offset_of(s, y.kappa))
    tangent = _projected(jnp.einsum("nij,...nj->...ni", shape.rotation, course))
    x, across = shape.position[:, 0], shape.position[:, 1]
    return _bending(y.kappa), _projected(shape.rotation[:, :, 0]), x, across, tangent


def describe(s: Sections, base: Base, loaded: Loaded, memory: Memory | None = None) -> Equilibrium:
    """The `Equilibrium` of a solved load step.

    Args:
        s: the robot at its nodes.
        base: where a robot in space stands.
        loaded: the step.
        memory: for the next equilibrium.
    """
    y = loaded.state
    shape = _shape(s, base, y) if isinstance(s.R, SpatialOffset) else None
    curvature, angle, x, across, tendon_angle = _seen(s, y, shape)
    return Equilibrium(
        s=s.mesh.s,
        curvature=curvature,
        angle=angle,
        tension=s.ended(loaded.tension),
        T_tip=loaded.T_tip,
        slip=loaded.slip,
        external_moment=y.moment,
        x=x,
        y=across,
        wrap=loaded.wrap,
        tendon_angle=tendon_angle,
        metric=metric_of(s, y.kappa),
        R=_from_axis(s, offset_of(s, y.kappa).value),
        tendon_length=tendon_length(s, y),
        mobilisation=loaded.mobilisation,
        result=outcome(loaded.result),
        residual_norm=loaded.residual_norm,
        iterations=loaded.iterations,
        memory=memory,
        shape=shape,
    )
