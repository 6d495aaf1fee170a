"""A law of the user's own in a robot file: `[[terms]]` with kind = "law", its parameters and their priors."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict, Field, SerializationInfo, SerializerFunctionWrapHandler, StrictStr
from pydantic import model_serializer as serializer

from gtr_jax.errors import InputError, did_you_mean, excerpt
from gtr_jax.terms import REGISTRY, Law, Quantity
from gtr_jax.terms.grammar import ExpressionError
from gtr_jax.terms.law import ACTS, check_law
from gtr_jax.units import parse_any, parse_quantity, quantity_text

from .section import TermSection

SIZE = "size"
_NAME, _PARAMETER = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*"), re.compile(r"[A-Za-z][A-Za-z0-9_]*")
MOST_PARAMETERS = 12
# Usual values of a parameter for which none are given, as multiples of its value.
_USUAL_SIZES, _USUAL_SCALES = (0.1, 3.0), (0.2, 5.0)
_NUMBER = {"anyOf": [{"type": "number"}, {"type": "string"}]}
_RANGES = {
    "type": "object",
    "additionalProperties": {"type": "array", "items": _NUMBER, "minItems": 2, "maxItems": 2},
}


def _open_keys(schema: dict[str, Any]) -> None:
    """Any other key is a parameter."""
    schema["additionalProperties"] = _NUMBER
    schema["properties"] |= {
        SIZE: _NUMBER | {"description": "The parameter at whose zero the law has no effect."},
        "usual": dict(_RANGES),
        "bounds": dict(_RANGES),
    }
    schema["required"] = [*schema["required"], SIZE]


class LawSection(TermSection):
    """A law of your own, as an expression; every key that is not listed is a parameter of it."""

    model_config = ConfigDict(extra="allow", json_schema_extra=_open_keys)

    kind: Literal["law"]
    """A law of your own."""
    name: StrictStr = "law"
    """Name, with which its parameters begin (seal.size)."""
    acts: Literal[
        "friction",
        "viscous",
        "drag",
        "bending",
        "strain",
        "tip_cell",
        "base_cell",
        "tip_response",
        "base_response",
    ] = Field(examples=["drag"])
    """Where it acts."""
    law: StrictStr = Field(examples=["size * exp(-p / fade)"])
    """The expression, of its parameters and of p, T, v, s, k, t, n, d and l, as they exist where it acts."""
    says: StrictStr = ""
    """One sentence on what it is."""
    units: dict[str, str] = Field(default_factory=dict)
    """SI units of parameters that are given as bare numbers."""
    usual: dict[str, tuple[float, float]] = Field(default_factory=dict)
    """Range of nine in ten values of each parameter: its prior in a diagnosis."""
    bounds: dict[str, tuple[float, float]] = Field(default_factory=dict)
    """Least and largest value of each parameter; inf where open."""
    log: tuple[StrictStr, ...] = ()
    """Parameters that are estimated on a logarithmic scale."""

    @property
    def id(self) -> str:
        """The name of the term."""
        return self.name

    @property
    def parameters(self) -> dict[str, float]:
        """Values of its parameters [SI]."""
        return dict(self.__pydantic_extra__ or {})

    @property
    def as_law(self) -> Law:
        """The law without the values of its parameters."""
        return Law(self.name, self.acts, self.law, tuple(map(self._quantity, self.parameters)), self.says)

    def _quantity(self, name: str) -> Quantity:
        low, high = self.usual[name]
        lower, upper = self.bounds.get(name, (-math.inf, math.inf))
        log = name in self.log
        middle = math.sqrt(low * high) if log else 0.5 * (low + high)
        return Quantity(
            name=name,
            unit=self.units[name],
            null=0.0 if name == SIZE else middle,
            typical=high if middle == 0.0 else middle,
            says=f"Parameter of {self.name}.",
            usual=(low, high),
            lower=lower if math.isfinite(lower) else None,
            upper=upper if math.isfinite(upper) else None,
            log=log,
            size=name == SIZE,
        )

    def checked(self) -> Law:
        """The law, if it can be one; InputError naming the key and the remedy."""
        law = self.as_law
        try:
            check_law(law, self.parameters)
        except ExpressionError as fault:
            raise InputError(f"terms.{self.name}.law: {fault}") from None
        return law

    @classmethod
    def _resolved(cls, data: dict[str, Any], folder: Path) -> dict[str, Any]:
        """Everything in SI, with the unit, usual range and bounds of every parameter."""
        name = data.get("name", "law")
        if isinstance(name, str) and (name in REGISTRY or not _NAME.fullmatch(name)):
            known = "is a term of the catalogue" if name in REGISTRY else "is not a valid name of a law"
            raise InputError(
                f"name: '{excerpt(name)}' {known}; take small letters, digits and -, and a letter first"
            )
        own = [key for key in data if key not in cls.model_fields]
        _check_names(own, data)
        tables = {key: dict(_table(key, data, own)) for key in ("units", "usual", "bounds")}
        values, units = {}, {}
        for key in own:
            units[key], values[key] = _read(key, data[key], tables["units"].get(key))
        ranges = {
            table: {key: _range(f"{table}.{key}", pair, units[key]) for key, pair in tables[table].items()}
            for table in ("usual", "bounds")
        }
        acts, log = data.get("acts"), data.get("log", ())
        if not isinstance(log, list | tuple) or not set(map(str, log)) <= set(own):
            raise InputError(f"log: expected names of parameters in brackets; there are {', '.join(own)}")
        for key in own:
            if _stays_positive(key, values[key], ranges["bounds"], log):
                ranges["bounds"][key] = (0.0, math.inf)
                log = (*log, key)
        if acts in ACTS and ACTS[acts].one_sided:
            ranges["bounds"].setdefault(SIZE, (0.0, math.inf))
        for key in own:
            least = ranges["bounds"].get(key, (-math.inf, math.inf))[0]
            if key not in ranges["usual"]:
                ranges["usual"][key] = _usual(key, values[key], units[key], least)
            low, _ = ranges["usual"][key]
            if key in log and (low <= 0 or key == SIZE):
                why = "may be zero" if key == SIZE else "has usual values that are not positive"
                raise InputError(f"log: {key} {why}; leave it out")
        return {**data, **values, "units": units, **ranges, "log": tuple(log)}

    @serializer(mode="wrap")
    def _written(self, handler: SerializerFunctionWrapHandler, info: SerializationInfo) -> dict[str, Any]:
        """As a file has it: with unit strings where they are asked for."""
        data = handler(self)
        if not (info.context or {}).get("unit_strings"):
            return data
        units = self.units
        data |= {name: quantity_text(value, units[name]) for name, value in self.parameters.items()}
        for table in ("usual", "bounds"):
            pairs = getattr(self, table)
            data[table] = {name: [_text(v, units[name]) for v in pair] for name, pair in pairs.items()}
        kept = {key: value for key, value in data.items() if key != "units" and value not in ({}, ())}
        return kept


def _text(value: float, unit: str) -> Any:
    return quantity_text(value, unit) if math.isfinite(value) else value


def _check_names(own: list[str], data: Mapping[str, Any]) -> None:
    if SIZE not in data:
        example = f'{SIZE} = "2 N/m"'
        raise InputError(
            f"missing key '{SIZE}', at whose zero the law has no effect; add for example {example}"
        )
    for key in own:
        if not _PARAMETER.fullmatch(key):
            raise InputError(
                f"'{excerpt(key)}' cannot be a parameter; take letters, digits and _, and a letter first"
            )
    if len(own) > MOST_PARAMETERS:
        raise InputError(f"has {len(own)} parameters; {MOST_PARAMETERS} are the most, so leave some out")


def _table(key: str, data: Mapping[str, Any], own: list[str]) -> Mapping[str, Any]:
    """One of the tables that say something of parameters."""
    table = data.get(key, {})
    if not isinstance(table, Mapping):
        raise InputError(f'{key}: expected a table of parameters, such as {key}.{SIZE} = ["1 N/m", "5 N/m"]')
    for name in table:
        if name not in own:
            raise InputError(f"{key}: no parameter '{excerpt(name)}'; {did_you_mean(str(name), own)}")
    return table


def _read(key: str, value: Any, unit: Any) -> tuple[str, float]:
    """SI unit and value of a parameter."""
    try:
        if unit is None:
            return parse_any(value)
        si, size = parse_any(f"1 {unit}")
        return si, parse_quantity(value, si) * (1.0 if isinstance(value, str) else size)
    except InputError as fault:
        raise InputError(f"{key}: {fault}") from None


def _range(key: str, pair: Any, unit: str) -> tuple[float, float]:
    """Two values in SI, the smaller one first; bounds that are infinite are so, or None as JSON has them."""
    if not isinstance(pair, list | tuple) or len(pair) != 2:
        raise InputError(f"{key}: expected two values in brackets, the smaller one first")
    ends = []
    for end, open_end in zip(pair, (-math.inf, math.inf), strict=True):
        is_open = key.startswith("bounds") and (end is None or end == open_end)
        try:
            ends.append(open_end if is_open else parse_quantity(end, unit))
        except InputError as fault:
            raise InputError(f"{key}: {fault}") from None
    if not ends[0] < ends[1]:
        raise InputError(f"{key}: the first value must be below the second; swap them")
    return ends[0], ends[1]


def _stays_positive(key: str, value: float, bounds: Mapping[str, Any], log: Any) -> bool:
    """Whether a parameter is a scale, which stays positive: unless bounds say otherwise, one that is."""
    return key != SIZE and value > 0 and key not in bounds and key not in log


def _usual(key: str, value: float, unit: str, least: float) -> tuple[float, float]:
    if value == 0.0:
        example = quantity_text(1.0, unit)
        example = f'"{example}"' if isinstance(example, str) else f"{example:g}"
        raise InputError(
            f"usual.{key}: is needed where {key} is zero: the range of nine in ten values, for example "
            f"usual.{key} = [0, {example}]"
        )
    if key == SIZE:
        low, high = (share * abs(value) for share in _USUAL_SIZES)
        return (low, high) if least >= 0 else (-high, high)
    low, high = _USUAL_SCALES if value > 0 and least >= 0 else (0.0, 2.0)
    ends = sorted((low * value, high * value))
    return ends[0], ends[1]
