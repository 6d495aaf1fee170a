"""What a compiled program of the mechanics contains. It is known before tracing, so that a program does not
compute what its robot does not need.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from ..terms import REGISTRY, Law, Term, catalogue_of

# The one term by which friction builds up with slip.
((PRESLIDING, mobilise),) = [(term.id, term.mobilise) for term in REGISTRY.values() if term.mobilise]


@dataclasses.dataclass(frozen=True)
class SolverOptions:
    """When the search for an equilibrium stops.

    Attributes:
        atol: largest residual that counts as solved, dimensionless: slip over length; all others as curvature
            times length.
        smallest_stride: smallest share of a load step that is tried. The whole step is tried first; if that
            fails, it is divided into 4, then 16, then 64 parts.
    """

    atol: float = 1e-9
    smallest_stride: float = 2.0**-6


@dataclasses.dataclass(frozen=True)
class ProgramSpec:
    """The static part of a load step. One compiled program serves all numerical values; another structure
    needs another program.

    Attributes:
        terms: names of the physics terms whose equations the program contains, in registry order; each still
            has no effect at its null value.
        tendons: length of the tendon axis; 0 for one tendon, whose arrays have no such axis.
        loaded: whether external forces may act, so that the external moment changes along the body.
        acting: whether all its terms are known to act, so that the law that holds a tendon is known.
        space: whether the robot may leave the plane, so that a node has three unknowns.
        laws: of the robot file, by which `terms` may be named too.
        skips: whether the laws of terms that do not act are passed over while it runs. The derivatives by
            their sizes are then lost.
    """

    terms: tuple[str, ...]
    tendons: int
    loaded: bool
    acting: bool = False
    space: bool = False
    laws: tuple[Law, ...] = ()
    skips: bool = False

    @property
    def catalogue(self) -> Mapping[str, Term]:
        """All terms by name, the laws among them."""
        return catalogue_of(self.laws)

    def hooks(self, name: str) -> list[tuple[str, Callable[..., Any]]]:
        """The terms that have the hook `name`, and their hooks."""
        return _hooks(self.terms, self.laws, name)

    def has(self, name: str) -> bool:
        """Whether any term has the hook `name`."""
        return bool(self.hooks(name))

    @property
    def shares_slip(self) -> bool:
        """Whether the slip of several tendons, which the body they share moves, decides their friction: so it
        does in the plane. In space each is held against its own base tension, as one tendon is.
        """
        return bool(self.tendons) and not self.space

    @property
    def counts_slip(self) -> bool:
        """Whether a step counts how far the tendons slip. The base model of one tendon, and of tendons in
        space, compares tensions only.
        """
        return bool(self.terms) or self.shares_slip

    @property
    def softens(self) -> bool:
        """Whether the body may grow far softer as it bends."""
        return any(self.catalogue[kind].softens for kind in self.terms)

    @property
    def by_strain(self) -> bool:
        """Whether a law of the body depends on the strain of its outermost fibre."""
        return any(self.catalogue[kind].by_strain for kind in self.terms)

    @property
    def by_place(self) -> bool:
        """Whether a law of the body depends on the arc length."""
        return any(self.catalogue[kind].by_place for kind in self.terms)

    @property
    def lags(self) -> bool:
        """Whether a body that grows softer may stay so until it is bent back a good way: the balance of a
        node then has a steep stretch between two flat ones, past which Newton's method would jump to and fro.
        """
        return any(self.catalogue[kind].softens and self.catalogue[kind].remembers for kind in self.terms)

    @functools.cached_property
    def presliding(self) -> bool:
        """Whether a term lets friction build up over a slip."""
        return self.has("mobilise")

    @functools.cached_property
    def creeping(self) -> bool:
        """Whether friction may change where the tendon is locked, so that a node is held against its
        neighbour.
        """
        return any(self.catalogue[kind].creeps for kind in self.terms)

    @functools.cached_property
    def loosens(self) -> bool:
        """Whether friction may fall with time, cycles or what is drawn out where one tendon is locked, so
        that the tension held there relaxes. Where friction follows the slip, it relaxes by itself.
        """
        return any(self.catalogue[kind].loosens for kind in self.terms) and not self._by_slip

    @functools.cached_property
    def slides(self) -> bool:
        """Whether friction of one tendon may grow with the speed of its slip, so that it slips on for a while
        after its base tension has turned back.
        """
        return self.has("by_speed") and not self._by_slip

    @functools.cached_property
    def tugged(self) -> bool:
        """Whether the end of one tendon may be moved from outside while friction holds it."""
        return self.has("tugged") and not self._by_slip

    @property
    def _by_slip(self) -> bool:
        """Whether friction is known to follow the slip."""
        return bool(self.tendons) or (self.acting and PRESLIDING in self.terms)

    @functools.cached_property
    def follows_slip(self) -> bool:
        """Whether a law of a node depends on the slip or its speed, in this step or the previous one."""
        reads = any(self.catalogue[kind].reads_speed for kind in self.terms)
        return self.presliding or reads or self.seeks_slip or self.shares_slip

    @functools.cached_property
    def remembers(self) -> bool:
        """Whether a law remembers more than the tension that friction holds: the body's past, how friction
        builds up, the time, the speed or what was drawn out.
        """
        ways = ("remembers", "elements", "timed", "creeps", "reads_speed", "reads_drawn", "by_speed")
        return any(getattr(self.catalogue[kind], way) for kind in self.terms for way in ways)

    @functools.cached_property
    def reads_drawn(self) -> bool:
        """Whether friction depends on how far the tendons are drawn out at the base."""
        return any(self.catalogue[kind].reads_drawn for kind in self.terms)

    @functools.cached_property
    def reads_channel(self) -> bool:
        """Whether friction at a tension depends on the place, the speed before, the time or the cycle."""
        return any(self.catalogue[kind].reads_channel for kind in self.terms)

    @functools.cached_property
    def seeks_slip(self) -> bool:
        """Whether the displacement at the base is unknown: a law depends on the slip of this step. Tendons
        that share their slip have another unknown, in each interval.
        """
        return (self.presliding or self.has("by_speed")) and not self.shares_slip

    @functools.cached_property
    def has_stop(self) -> bool:
        """Whether the tip may run into a stop."""
        return self.has("stop")

    @functools.cached_property
    def bends(self) -> bool:
        """Whether the external moment changes along the body, so that it is unknown at the base."""
        return self.loaded or self.has_stop

    @functools.cached_property
    def carries(self) -> bool:
        """Whether the body may bend where friction holds the tendon, so that the held stretch is carried
        along.
        """
        return bool(carried(self.terms, self.catalogue)) and not self._by_slip

    @functools.cached_property
    def unknowns(self) -> int:
        """How many numbers are unknown at the base."""
        slips = max(self.tendons, 1) * self.seeks_slip
        return slips + self.moments * self.bends + self.has_stop + self.carries

    @property
    def moments(self) -> int:
        """How many components a moment has."""
        return 3 if self.space else 1


def carried(terms: Iterable[str], catalogue: Mapping[str, Term]) -> list[str]:
    """The terms among `terms` that bend the body where friction holds its tendon."""
    return [kind for kind in terms if catalogue[kind].stop or catalogue[kind].relaxes]


@functools.cache
def _hooks(terms: tuple[str, ...], laws: tuple[Law, ...], name: str) -> list[tuple[str, Callable[..., Any]]]:
    known = catalogue_of(laws)
    return [(kind, hook) for kind in terms if (hook := getattr(known[kind], name))]


def in_order(kinds: Iterable[str], laws: tuple[Law, ...] = ()) -> tuple[str, ...]:
    """The given names of terms in the order of the catalogue, each once, without those of the load cells."""
    wanted = set(kinds)
    return tuple(kind for kind, term in catalogue_of(laws).items() if kind in wanted and not term.of_cells)


def every(laws: tuple[Law, ...] = ()) -> tuple[str, ...]:
    """All terms but those of the load cells."""
    return in_order(catalogue_of(laws), laws)
