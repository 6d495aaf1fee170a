"""What a program of the mechanics holds: known before anything is traced, so that it pays for nothing
else.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable
from typing import Any

from ..terms import REGISTRY

((PRESLIDING, mobilise),) = [(term.id, term.mobilise) for term in REGISTRY.values() if term.mobilise]


@dataclasses.dataclass(frozen=True)
class March:
    """How far the search for an equilibrium goes.

    Attributes:
        atol: largest residual at which it stops, dimensionless: slip by length, the rest as curvature times
            length.
        smallest_stride: share of a load step below which it is given up. The whole step is tried first; where
            that fails, it is made in 4, 16 and at last 64 parts.
    """

    atol: float = 1e-9
    smallest_stride: float = 2.0**-6


@dataclasses.dataclass(frozen=True)
class Structure:
    """The static side of a load step. A program serves all values; another structure is another program.

    Attributes:
        terms: names of the physics terms whose equations it holds, in the order of the registry; each still
            does nothing at its null value.
        tendons: how many tendons have an axis; 0 for one tendon, which has none.
        loaded: whether external forces may act, so that the external moment changes along the body.
        acting: whether all its terms are known to act, so that the law that holds a tendon is known.
    """

    terms: tuple[str, ...]
    tendons: int
    loaded: bool
    acting: bool = False

    def hooks(self, name: str) -> list[tuple[str, Callable[..., Any]]]:
        """Its terms that have a hook, and the hook."""
        return _hooks(self.terms, name)

    def has(self, name: str) -> bool:
        """Whether any of its terms has a hook."""
        return bool(self.hooks(name))

    @functools.cached_property
    def presliding(self) -> bool:
        """Whether friction may build up over a slip. Several tendons with terms always have that."""
        return self.has("mobilise") or (bool(self.tendons) and bool(self.terms))

    @functools.cached_property
    def creeping(self) -> bool:
        """Whether friction may change where the tendon is locked, so that its neighbour holds it."""
        return any(REGISTRY[kind].creeps for kind in self.terms)

    @functools.cached_property
    def follows_slip(self) -> bool:
        """Whether a law of a node depends on the slip or its speed, in this step or the one before."""
        return self.presliding or any(REGISTRY[kind].reads_speed for kind in self.terms) or self.seeks_slip

    @functools.cached_property
    def seeks_slip(self) -> bool:
        """Whether the displacement at the base is unknown: a law depends on the slip of this step."""
        return self.presliding or self.has("by_speed")

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
        """Whether a stretch of a tendon that friction holds may be bent, and is carried along."""
        by_slip = self.tendons or (self.acting and PRESLIDING in self.terms)
        return bool(carried(self.terms)) and not by_slip

    @functools.cached_property
    def unknowns(self) -> int:
        """How many numbers are unknown at the base."""
        return max(self.tendons, 1) * self.seeks_slip + self.bends + self.has_stop + self.carries


def carried(terms: Iterable[str]) -> list[str]:
    """Those of some terms that bend the body where friction holds its tendon."""
    return [kind for kind in terms if REGISTRY[kind].stop or REGISTRY[kind].relaxes]


@functools.cache
def _hooks(terms: tuple[str, ...], name: str) -> list[tuple[str, Callable[..., Any]]]:
    return [(kind, getattr(REGISTRY[kind], name)) for kind in terms if getattr(REGISTRY[kind], name)]


def in_order(kinds: Iterable[str]) -> tuple[str, ...]:
    """Names of terms that are not of the load cells, in the order of the registry, each once."""
    wanted = set(kinds)
    return tuple(kind for kind, term in REGISTRY.items() if kind in wanted and not term.of_cells)


EVERY = in_order(REGISTRY)
