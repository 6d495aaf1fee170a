"""The solution of one equilibrium, and the quantities computed from its state."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ..mechanics import Memory, Settled, Step, Structure, channel, metric_of
from ..mechanics.mesh import cumulative, increments
from ..mechanics.sections import Sections, State, at_tendons
from ..terms import REGISTRY
from ..terms.term import Values
from .outcome import outcome


class Equilibrium(eqx.Module):
    """Solution of one equilibrium, SI units; N nodes from base to tip; panel ends appear twice. May carry
    batch axes in front. Quantities of a tendon have a tendon axis where the robot has several tendons.

    Attributes:
        s: arc length of the nodes, (N,).
        curvature, angle: of the midline, (N,).
        tension: of the tendon, (*tendons, N).
        T_tip: tension at the tip's anchor, past any friction lumped there, (*tendons,).
        slip: of the tendon towards the base, since the robot settled with slack tendons, (*tendons, N).
        external_moment: moment of the external loads, (N,).
        x, y: midline, (N,).
        wrap: total turning of the tendon since the base, (*tendons, N).
        tendon_angle: psi of the tendon's tangent from the x axis [rad], (*tendons, N).
        metric: nu = ds_c/ds of the channel, (*tendons, N).
        R: channel offset, (*tendons, N).
        tendon_length: length of the channel, (*tendons,).
        mobilisation: of friction between each node and the one before it, +1 slipping towards the base, -1
            towards the tip, between where locked, (tendons, N); None for one tendon.
        result: optimistix result; compare with `optimistix.RESULTS.successful`.
        residual_norm: dimensionless, see `problem.residual_norm`; ().
        iterations: marches taken, ().
        memory: what physics terms remember, for the next equilibrium; None if read off a simulation.
    """

    s: Float[Array, " N"]
    curvature: Float[Array, " N"]
    angle: Float[Array, " N"]
    tension: Float[Array, "*tendons N"]
    T_tip: Float[Array, "*tendons"]
    slip: Float[Array, "*tendons N"]
    external_moment: Float[Array, " N"]
    x: Float[Array, " N"]
    y: Float[Array, " N"]
    wrap: Float[Array, "*tendons N"]
    tendon_angle: Float[Array, "*tendons N"]
    metric: Float[Array, "*tendons N"]
    R: Float[Array, "*tendons N"]
    tendon_length: Float[Array, "*tendons"]
    mobilisation: Float[Array, "tendons N"] | None
    result: optx.RESULTS
    residual_norm: Float[Array, ""]
    iterations: Int[Array, ""]
    memory: Memory | None = None

    @property
    def tip_pose(self) -> Float[Array, "*batch 3"]:
        """Midline tip: x [m], y [m], angle [rad]."""
        return jnp.stack([self.x[..., -1], self.y[..., -1], self.angle[..., -1]], axis=-1)

    @property
    def converged(self) -> Bool[Array, "*batch"]:
        """True where the solver met its tolerance."""
        return self.result == optx.RESULTS.successful

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
            strung = term.ahead(values, jnp.broadcast_to(preload, T_base.shape))
            slip = slip + term.ahead(values, T_base) - strung
    return slip


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


def loaded_of(s: Sections, structure: Structure, settled: Settled, done: Step) -> Loaded:
    """A solved load step with nodes along the last axis; in the base model, slip is without stretch."""

    def nodes_last(values):
        return jnp.moveaxis(values, 0, -1)

    wrap = nodes_last(jnp.cumsum(done.state.wrap, axis=0))
    if done.slip is None:
        slipped = slip_without_stretch(s, dataclasses.replace(done.state, kappa=settled.kappa), done.state)
    else:
        slipped = nodes_last(done.slip)
    several = done.mobilised is not None and bool(structure.tendons)
    return Loaded(
        state=dataclasses.replace(done.state, wrap=wrap),
        tension=nodes_last(done.tension),
        T_tip=done.T_tip,
        slip=slipped,
        wrap=wrap,
        mobilisation=nodes_last(done.mobilised) if several else None,
        result=optx.RESULTS.where(
            done.met, optx.RESULTS.successful, optx.RESULTS.nonlinear_max_steps_reached
        ),
        residual_norm=done.error,
        iterations=done.marches,
    )


def describe(s: Sections, loaded: Loaded, memory: Memory | None = None) -> Equilibrium:
    """The `Equilibrium` of a solved load step."""
    y = loaded.state
    return Equilibrium(
        s=s.mesh.s,
        curvature=y.kappa,
        angle=y.phi,
        tension=loaded.tension,
        T_tip=loaded.T_tip,
        slip=loaded.slip,
        external_moment=y.moment,
        x=cumulative(s.mesh.weights, jnp.cos(y.phi)),
        y=cumulative(s.mesh.weights, jnp.sin(y.phi)),
        wrap=loaded.wrap,
        tendon_angle=at_tendons(y.phi, s.R) + channel.tangent_lead(at_tendons(y.kappa, s.R), s.R),
        metric=metric_of(s, y.kappa),
        R=s.R.value,
        tendon_length=tendon_length(s, y),
        mobilisation=loaded.mobilisation,
        result=outcome(loaded.result),
        residual_norm=loaded.residual_norm,
        iterations=loaded.iterations,
        memory=memory,
    )
