"""What a physics term is: an effect that the base model leaves out, dormant at its null value."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

from jaxtyping import Array, Float

Values = Mapping[str, Float[Array, ""]]
Cell = Callable[[Values, Float[Array, " K"]], Float[Array, " K"]]


@dataclasses.dataclass(frozen=True)
class Quantity:
    """One number of a term.

    Attributes:
        name: its key in the robot file.
        unit: SI unit, "dimensionless" if it has none.
        null: value at which the term does nothing.
        typical: a value that people meet.
        says: what it is, for people.
        lower, upper: bounds in SI; None where open.
        log: whether it is estimated on a logarithmic scale.
    """

    name: str
    unit: str
    null: float
    typical: float
    says: str
    lower: float | None = None
    upper: float | None = None
    log: bool = False


@dataclasses.dataclass(frozen=True)
class Term:
    """One effect.

    Attributes:
        id: its `kind` in robot files.
        says: one sentence for people.
        law: its equation.
        seen: what it looks like in a recording.
        told_apart: which experiment tells it from its rivals.
        quantities: its numbers.
        tip, base: what the cell at the tip, or the base, shows for true tensions; None if not touched.
        true_base: the true base tensions for what its cell shows; the inverse of `base`.
    """

    id: str
    says: str
    law: str
    seen: str
    told_apart: str
    quantities: tuple[Quantity, ...]
    tip: Cell | None = None
    base: Cell | None = None
    true_base: Cell | None = None
