"""How far a tendon is pulled: to a tension, or by a displacement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from gtr_jax.errors import InputError
from gtr_jax.units import parse_quantity, quantity_text

TENSION, DISPLACEMENT = "N", "m"  # units that tell the two apart


class Amount(NamedTuple):
    """How far a tendon is pulled, in SI: a tension (unit "N") or a displacement ("m"); and how it is
    written.
    """

    value: float
    unit: str
    text: str


def amount_of(given: Any) -> Amount:
    """A tension, in newtons without a unit, or a displacement with its unit of length.

    Raises InputError without the place.
    """
    try:
        return Amount(parse_quantity(given, TENSION), TENSION, str(given))
    except InputError as fault:
        try:
            if isinstance(given, str):
                return Amount(parse_quantity(given, DISPLACEMENT), DISPLACEMENT, given)
        except InputError:
            pass
        raise fault from None


def unit_of(drive: str) -> str:
    """The unit of what a drive of a robot file, "tension" or "displacement", sets."""
    return TENSION if drive == "tension" else DISPLACEMENT


@dataclass(frozen=True)
class Pulled:
    """Marks a pydantic `Amount` of a file, `Annotated[Amount, Pulled()]`; written as `Unit` does it."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(
            lambda value: value if isinstance(value, Amount) else amount_of(value),
            serialization=core_schema.plain_serializer_function_ser_schema(self._serialise, info_arg=True),
        )

    def _serialise(self, amount: Amount, info: Any) -> str | float:
        whole = (info.context or {}).get("unit_strings") or amount.unit != TENSION
        return quantity_text(amount.value, amount.unit) if whole else amount.value
