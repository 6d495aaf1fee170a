"""The outcome of a solve in readable form: `print(equilibrium.result)` prints `successful`. To the results of
optimistix one is added, of a solve whose robot no robot can be.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import jax.tree_util as jtu
import numpy as np
import optimistix as optx
from equinox._enum import EnumerationItem
from jaxtyping import Array, Bool

_OUTSIDE = len(optx.RESULTS._name_to_item)  # behind the codes of optimistix
MEANING = (
    "The equations have a solution, but a number of the robot is outside physics: a stiffness not above "
    "zero, friction below zero, a channel outside the body, or another for which a robot file is refused."
)


class Outcome(EnumerationItem):
    """An item of `optimistix.RESULTS`, or an array of them, that prints its name and what it means."""

    def __repr__(self) -> str:
        if self.is_traced():
            return f"{self._enumeration.__qualname__}<traced>"
        names = {int(item._value): name for name, item in self._enumeration._name_to_item.items()}
        names[_OUTSIDE] = "outside_physics"
        values, counts = np.unique(np.asarray(self._value), return_counts=True)
        if np.ndim(self._value):
            return ", ".join(f"{n} {names[int(v)]}" for v, n in zip(values, counts, strict=True))
        index = int(values[0])
        meaning = MEANING if index == _OUTSIDE else self._enumeration._index_to_message[index]
        return f"{names[index]}: {meaning}" if meaning else names[index]


def outcome(result: optx.RESULTS) -> Any:
    """The result as an `Outcome`, which prints its name."""
    return Outcome(result._value, result._enumeration)


OUTSIDE_PHYSICS = Outcome(np.array(_OUTSIDE, np.int32), optx.RESULTS)


def unless_outside(result: Any, valid: Bool[Array, ""]) -> Any:
    """The result, or results, of a solve; `OUTSIDE_PHYSICS` where it succeeded and the robot is not valid."""
    return _unless(valid, result, OUTSIDE_PHYSICS)


def unless_missed(result: Any, good: Bool[Array, " K"]) -> Any:
    """The results of K steps; not converged where a step succeeded and is not to be trusted."""
    return _unless(good, result, outcome(optx.RESULTS.nonlinear_max_steps_reached))


def _unless(holds: Bool[Array, "*K"], result: Any, other: Any) -> Any:
    """A result; another where it is success and something does not hold."""

    def unless(code, other, successful):
        return jnp.where(holds | (code != successful), code, other)

    return jtu.tree_map(unless, result, other, outcome(optx.RESULTS.successful))


def is_solved(result: Any) -> Any:
    """Whether the equations were solved, be it for numbers of no robot: what a search goes by that keeps to
    the bounds of its numbers by itself.
    """
    return (result == optx.RESULTS.successful) | (result == OUTSIDE_PHYSICS)


class WithResult:
    """What equilibria and load histories say of how their equations were solved, each or step by step.

    Attributes:
        result: of the solver.
    """

    result: Any

    @property
    def converged(self) -> Bool[Array, "*batch"]:
        """True where the solver met its tolerance, of a robot that can be."""
        return self.result == optx.RESULTS.successful

    @property
    def outside_physics(self) -> Bool[Array, "*batch"]:
        """True where the equations were solved for numbers of no robot: a negative modulus, friction below
        zero, a channel outside the body.
        """
        return self.result == OUTSIDE_PHYSICS

    @property
    def solved(self) -> Bool[Array, "*batch"]:
        """As `converged`, of any numbers."""
        return is_solved(self.result)
