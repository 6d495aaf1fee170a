"""What a robot in the plane and one in space do differently: how strain turns the body, and what a channel
does in it.

The *strain* is what the balance of moments is solved for: the curvature of a robot in the plane, (); twist
and the two bendings, (3,), of one in space. The *direction* of a section is the angle of its midline in the
plane, and the rotation of its frame in space, (3, 3). Every method takes a node, or all nodes along the axis
of its arrays that `SpatialOffset` and `Offset` have them in.
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import Any

from jaxtyping import Array, Float

from ..terms.term import Bent, Term, Values
from .mesh import Interval


class Geometry(abc.ABC):
    """The geometry of rod and channel; see `plane.Plane` and `space.Space`."""

    @abc.abstractmethod
    def split(self, values: Array) -> Any:
        """A strain or moment of the node equations from its array."""

    @abc.abstractmethod
    def join(self, values: Any) -> Array:
        """Its array."""

    @abc.abstractmethod
    def split_direction(self, direction: Array) -> Any:
        """A direction of the node equations from its array."""

    @abc.abstractmethod
    def join_direction(self, direction: Any) -> Array:
        """Its array."""

    @abc.abstractmethod
    def zero(self) -> Any:
        """A moment of zero."""

    @abc.abstractmethod
    def unstrained(self) -> Any:
        """A strain of zero."""

    @abc.abstractmethod
    def start(self) -> Any:
        """Direction of the section at the base."""

    @abc.abstractmethod
    def turn(self, step, strain, before, length) -> Any:
        """How the body turns over an interval.

        Args:
            step: integral of the strain over it.
            strain, before: at its two ends [1/m].
            length: of it [m].
        """

    @abc.abstractmethod
    def onward(self, direction, turn) -> Any:
        """Direction after a turn."""

    @abc.abstractmethod
    def directions(self, weights: Float[Array, "N 4"], interval: Interval, strain) -> Any:
        """Directions of all nodes, (N, ...), from their strain."""

    @abc.abstractmethod
    def wrap(self, turn, strain, before, rates, R, R_before, between: Interval) -> Any:
        """Turning of the tendons [rad] between a node and the one before it, over a turn of the body.

        Args:
            turn: of the body, from `turn`.
            strain, before: at the node and at its predecessor [1/m].
            rates: derivatives of the strain there [1/m^2]; None in the plane.
            R, R_before: channel offsets there.
            between: the interval.
        """

    @abc.abstractmethod
    def metric(self, strain, R) -> Any:
        """nu = ds_c/ds of the channels."""

    @abc.abstractmethod
    def pull(self, tension, strain, R) -> Any:
        """Moment of the tendons' tensions on the section at a node [N m]: -(sum of r x T t)."""

    @abc.abstractmethod
    def give(self, compliance, strain, R) -> Any:
        """How much of a tendon slips out of its channel, per length and tension, because the body bends
        [1/N].
        """

    @abc.abstractmethod
    def moment_slope(self, direction, force) -> Any:
        """M_ext' = -(t x n_ext) [N], for the direction of a section and the force distal to it."""

    @abc.abstractmethod
    def felt(self, direction, moment) -> Any:
        """External moment in the directions of the section [N m]."""

    @abc.abstractmethod
    def inner(self, one, other) -> Any:
        """Inner product of two moments or strains."""

    @abc.abstractmethod
    def bent(self, term: Term, values: Values, strain, at: Bent) -> tuple[Any, Any]:
        """What the bending law of a term adds to the moment over EI [1/m], and what it remembers."""

    @abc.abstractmethod
    def way_of(self, term: Term, values: Values) -> Any:
        """Direction in which the tip runs into the stop of a term."""

    @abc.abstractmethod
    def components(self, way) -> Any:
        """Components of such a direction."""

    @abc.abstractmethod
    def advance(self, direction, way) -> Any:
        """Component of the midline's tangent along such a direction."""

    @abc.abstractmethod
    def lever(self, direction, force, length) -> Any:
        """Moment about the base of forces on a body of known shape [N m]."""

    @abc.abstractmethod
    def line(self, direction) -> Any:
        """Components of the midline's tangent."""

    @abc.abstractmethod
    def stretch(self, strain, shift) -> Any:
        """Length of the axis per length that it has unbent; None where it keeps its length.

        Args:
            strain: of the section.
            shift: of the axis from the neutral line, as of `Sections`, or None.
        """

    @abc.abstractmethod
    def pushed(self, pulls, direction, force, shift) -> Any:
        """Moments of `pull` with what external forces beyond the section add, of which those act that push
        along the axis: where the axis stretches, that force; where it lies beside the neutral line, their
        moment about that.

        Args:
            pulls: of `pull`.
            direction: of the section.
            force: the external force beyond it [N].
            shift: of the axis from the neutral line, as of `Sections`, or None.
        """

    @abc.abstractmethod
    def bending_slope(self, law: Callable, strain) -> Any:
        """Derivative of a bending law by the strain, as `near` has that of the residual."""

    @abc.abstractmethod
    def slackened(self, start, rest, compliance, tension, moment, R) -> Any:
        """Strain that a node would have under given tensions and external moment [1/m], approximately.

        Args:
            start: strain to start from, where it helps [1/m].
            rest, compliance: of the section.
            tension, moment: of the tendons [N], and external in the axes of the section [N m].
            R: channel offset.
        """

    @abc.abstractmethod
    def root(
        self,
        residual: Callable,
        guess,
        near: Callable,
        steps: int,
        flattest: float,
        stopped: Callable | None,
        first: Any,
    ) -> Any:
        """Root of a node's residual.

        Args:
            residual: from a strain.
            guess: to start from.
            near: its derivative at a strain if nothing else changes over the interval.
            steps: how many are taken, at least.
            flattest: slope below which a step in the plane is shortened.
            stopped: where a step in the plane ends, from where it starts and would end; None: there.
            first: least slope of the first step in the plane, where the slope may be that of the elastic
                body, 1, between two flat stretches: steps then stay between what is known to be too little
                and too much. None where it has no such stretch.
        """

    @abc.abstractmethod
    def near(self, compliance, tension, strain, R) -> Any:
        """Derivative of a node's residual by its strain if tensions do not change; None where not needed."""

    @abc.abstractmethod
    def slope(self, residual: Callable, strain) -> tuple[Any, Any]:
        """A node's residual, and its derivative by the strain."""

    @abc.abstractmethod
    def quotient(self, change, slope) -> Any:
        """Change of the strain that changes the residual by `change`."""
