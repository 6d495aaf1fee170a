"""One load step: the robot at its nodes, its load, and the memory of the previous step."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .program_spec import ProgramSpec, every
from .sections import Sections, State

FOREVER = 1e15  # s, a time after which all creep has ended
FOLLOWED = (
    "slip",
    "drawn_earlier",
    "middle",
    "speed",
    "mobilised",
    "stencil",
    "elements",
    "xi",
)  # of `Memory`, may be None


class Load(eqx.Module):
    """One step of a load history; or several, along a leading axis.

    Attributes:
        T_base: base tension [N], (*tendons,).
        dt: time since the previous step [s].
        time: since the first sample [s].
        cycle: pulls and releases done, half a cycle each.
        turned: those since the previous step.
    """

    T_base: Float[Array, "*steps_tendons"]
    dt: Float[Array, "*steps"]
    time: Float[Array, "*steps"]
    cycle: Float[Array, "*steps"]
    turned: Float[Array, "*steps"]

    @classmethod
    def without_clock(cls, T_base: Float[Array, "*tendons"]) -> Load:
        """A base tension [N] that is reached at leisure: all creep has ended, nothing else has happened."""
        nil = jnp.zeros(())
        return cls(T_base, FOREVER * jnp.ones(()), nil, nil, nil)


class Memory(eqx.Module):
    """What is remembered of the previous step, nodes along the first axis; None where no law of the structure
    needs it.

    Attributes:
        tension: at the nodes [N], (N, *tendons).
        kappa: curvature, in space strain [1/m], (N, *strain).
        slip: towards the base, at the nodes [m], (N, *tendons).
        drawn_earlier: slip at the base after the step before that [m], (*tendons,).
        middle: slip midway between each node and its predecessor [m], (N, *tendons).
        speed: of the slip at these midpoints [m/s], (N, *tendons).
        mobilised: share of friction mobilised there, in [-1, 1], (N, *tendons).
        stencil: turning since the preceding node minus its value by the trapezoidal rule [rad], from the step
            in which the tendon last slipped there, (N, *tendons).
        elements: memory of the presliding law, (N, elements, *tendons).
        bent: memory of the bending laws, (N, numbers, *moment) each.
        entry: tension where the tendon enters the channel, past the friction lumped ahead of it [N],
            (*tendons,).
        T_tip: tension at the anchor [N], (*tendons,).
        T_base: base tension [N], (*tendons,).
        carried: share of the external loads that the body carries: 0 before it settles, 1 from then on.
        unknowns: solution for the unknowns at the base, (n,), see `march.Closing`; None where nothing is
            unknown.
        xi: solution for how friction grips tendons that share their slip, see `coulomb.mobilisation`, (N,
            *tendons).
    """

    tension: Float[Array, "N *tendons"]
    kappa: Float[Array, "N *strain"]
    slip: Float[Array, "N *tendons"] | None
    drawn_earlier: Float[Array, "*tendons"] | None
    middle: Float[Array, "N *tendons"] | None
    speed: Float[Array, "N *tendons"] | None
    mobilised: Float[Array, "N *tendons"] | None
    stencil: Float[Array, "N *tendons"] | None
    elements: Float[Array, "N elements *tendons"] | None
    bent: dict[str, Float[Array, "N _ *moment"]]
    entry: Float[Array, "*tendons"]
    T_tip: Float[Array, "*tendons"]
    T_base: Float[Array, "*tendons"]
    carried: Float[Array, ""]
    unknowns: Float[Array, " n"] | None
    xi: Float[Array, "N *tendons"] | None = None


class Sliding(NamedTuple):
    """What is predicted of the slip in a load step (`sliding.predicted_slip`).

    Attributes:
        way: how far friction is mobilised by the slip past the interval ahead of each node, (N,): 1 wholly,
            by slip towards the base, -1 towards the tip, between them where the slip turns round.
        confidence: whether it is, (N,): 1 where the tendon slips, 0 where it is held or where nothing is
            predicted, between them where it is predicted to slip, and its tension to change, by next to
            nothing.
    """

    way: Float[Array, " N"]
    confidence: Float[Array, " N"]


class Grip(NamedTuple):
    """How friction grips tendons that share their slip.

    Attributes:
        xi: the unknown, see `coulomb.mobilisation`, in the interval ahead of each node.
        slipped: slip towards the base in the load step there [m].
        mobilised: share of friction mobilised there.
        elements: memory of the presliding law; None without it.
    """

    xi: Float[Array, "N *tendons"]
    slipped: Float[Array, "N *tendons"]
    mobilised: Float[Array, "N *tendons"]
    elements: Float[Array, "N elements *tendons"] | None


class Case(eqx.Module):
    """One load step.

    Attributes:
        sections: the robot at the nodes.
        mu: friction coefficient [-], (*tendons,).
        preload: tension at which the tendon's strain counts as zero [N], (*tendons,).
        tip_moment: external moment at the tip [N m], (); in space (3,).
        terms: the numbers of the physics terms, by term and name.
        metric: nu of the channels before the first load, (N, *tendons); None where no slip is needed.
        load: the load.
        memory: of the previous step.
        sliding: what is predicted of the slip in the step; None where no law asks.
        grip: how friction grips tendons that share their slip, which is unknown; None of others.
        against: factor on the speed where the tendon slips opposite to the sense for which friction is
            evaluated: 1 at the solution, less on the way to it.
        structure: which equations act (static).
    """

    sections: Sections
    mu: Float[Array, "*tendons"]
    preload: Float[Array, "*tendons"]
    tip_moment: Float[Array, "*moment"]
    terms: dict[str, dict[str, Float[Array, "*each"]]]
    metric: Float[Array, "N *tendons"] | None
    load: Load
    memory: Memory
    sliding: Sliding | None
    grip: Grip | None
    against: Float[Array, ""]
    structure: ProgramSpec = eqx.field(static=True)

    @property
    def varied(self) -> tuple[Array, ...]:
        """What usually differs where many robots or loads are solved side by side."""
        s = self.sections
        acting = [value for kind in self.structure.terms for value in self.terms[kind].values()]
        return (self.mu, self.load.T_base, s.compliance, s.rest, s.R.value, self.memory.tension, *acting)


def untouched(
    structure: ProgramSpec, state: State, tension: Float[Array, "N *tendons"], carried: Float[Array, ""]
) -> Memory:
    """The memory of a robot that was never pulled.

    Args:
        structure: what the program holds.
        state: of the body without tension in its tendons.
        tension: along the tendons [N], (N, *tendons).
        carried: share of the external loads that the state carries.
    """
    none, at_base, nodes = jnp.zeros_like(tension), tension[0], tension.shape[0]
    told = none if structure.counts_slip else None
    followed = none if structure.follows_slip else None
    count = max(term.elements for term in structure.catalogue.values())
    moment = state.moment[0]
    return Memory(
        tension=tension,
        kappa=state.kappa,
        slip=told,
        drawn_earlier=jnp.zeros_like(at_base) if structure.reads_drawn else None,
        middle=followed,
        speed=followed,
        mobilised=told,
        stencil=none if structure.creeping else None,
        elements=jnp.zeros((nodes, count, *at_base.shape)) if structure.presliding else None,
        bent={
            kind: jnp.zeros((nodes, structure.catalogue[kind].remembers, *state.moment.shape[1:]))
            for kind, _ in structure.hooks("bend")
        },
        entry=at_base,
        T_tip=at_base,
        T_base=jnp.zeros_like(at_base),
        carried=carried,
        unknowns=_unknowns(structure, jnp.zeros(at_base.size), moment, jnp.zeros(())),
        xi=none if structure.shares_slip else None,
    )


def complete(
    memory: Memory, structure: ProgramSpec, state: State, slip: Float[Array, "N *tendons"]
) -> Memory:
    """A memory extended by everything that a program of another structure may need.

    Args:
        memory: what a program of `structure` left.
        structure: of that program.
        state: of the body, the nodes in its first or only axis.
        slip: of the tendons [m], (N, *tendons).
    """
    whole = _every(structure)
    full = untouched(whole, state, memory.tension, memory.carried)
    before = jnp.concatenate([slip[:1], slip[:-1]])
    drawn = slip[0] if whole.reads_drawn else None
    known = {name: value for name in FOLLOWED if (value := getattr(memory, name)) is not None}
    displacement, moment, stop = _split(memory.unknowns, structure, slip[0].ravel(), state.moment[0])
    return dataclasses.replace(
        full,
        **{"slip": slip, "drawn_earlier": drawn, "middle": 0.5 * (slip + before)} | known,
        bent=full.bent | memory.bent,
        unknowns=_unknowns(whole, displacement, moment, stop),
        **{name: getattr(memory, name) for name in ("kappa", "entry", "T_tip", "T_base")},
    )


def part_of(memory: Memory, structure: ProgramSpec) -> Memory:
    """The part of a complete memory that a program of a structure needs."""
    whole = _every(structure)
    displacement, moment, stop = _split(memory.unknowns, whole, jnp.zeros(0), jnp.zeros(()))
    asked = {
        "slip": structure.counts_slip,
        "mobilised": structure.counts_slip,
        "drawn_earlier": structure.reads_drawn,
        "middle": structure.follows_slip,
        "speed": structure.follows_slip,
        "stencil": structure.creeping,
        "elements": structure.presliding,
        "xi": structure.shares_slip,
    }
    return dataclasses.replace(
        memory,
        **{name: None for name, wanted in asked.items() if not wanted},
        bent={kind: memory.bent[kind] for kind, _ in structure.hooks("bend")},
        unknowns=_unknowns(structure, displacement, moment, stop),
    )


def _every(structure: ProgramSpec) -> ProgramSpec:
    """The structure of all equations that its robot may need."""
    return dataclasses.replace(structure, terms=every(structure.laws), loaded=True, acting=False)


def _unknowns(structure: ProgramSpec, displacement, moment, stop) -> Float[Array, " n"] | None:
    """Displacements, moment and stop force as one vector, as far as they are unknown; None where none is."""
    parts = [displacement] * structure.seeks_slip + [moment.ravel()] * structure.bends
    parts += [stop[None]] * structure.has_stop
    # The level starts from 0 in every step: the remembered tension itself.
    parts += [jnp.zeros(1)] * structure.carries
    return jnp.concatenate(parts) if parts else None


def _split(unknowns: Float[Array, " n"] | None, structure: ProgramSpec, displacement, moment):
    """Displacements, moment and stop force from a vector of unknowns; the given ones where known."""
    if unknowns is None:
        return displacement, moment, jnp.zeros(())
    count = max(structure.tendons, 1) * structure.seeks_slip
    displacement = unknowns[:count] if structure.seeks_slip else displacement
    after = count + structure.moments * structure.bends
    if structure.bends:
        moment = unknowns[count:after] if structure.space else unknowns[count]
    return displacement, moment, unknowns[after] if structure.has_stop else jnp.zeros(())
