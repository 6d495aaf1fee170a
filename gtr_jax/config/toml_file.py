"""The robot file as it lies on the disk: TOML and routing tables read, nested keys found by dotted names."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from gtr_jax.errors import InputError, did_you_mean, excerpt, listed
from gtr_jax.recordings.formats.quantities import split_unit
from gtr_jax.recordings.formats.table import read_table
from gtr_jax.recordings.formats.text import read_text


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Contents of a TOML file; InputError if it is absent, empty or not TOML."""
    text, _ = read_text(path)
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: not TOML: brackets nested too deep; close them") from None
    except ValueError as fault:  # TOMLDecodeError, and what int and datetime raise
        raise InputError(
            f'{path}: not TOML: {fault}; write key = "value unit" under [section] lines'
        ) from None
    _check_integers(data, str(path))
    return data


def _check_integers(node: Any, place: str, sign: str = ": ") -> None:
    """InputError naming the key of an integer of more than 64 bits, which TOML does not have."""
    if isinstance(node, int) and not -(2**63) <= node < 2**63:
        raise InputError(f"{place}: {excerpt(node)} has too many digits for an integer; correct it")
    if isinstance(node, dict):
        for key, value in node.items():
            _check_integers(value, f"{place}{sign}{key}", ".")
    elif isinstance(node, list):
        for i, value in enumerate(node):
            _check_integers(value, f"{place}[{i}]", ".")


def read_route(path: Path, names: Sequence[str] = ("s", "R")) -> tuple[tuple[float, ...], ...]:
    """Knots [m] of a routing table, a column for each of `names`; InputError naming file, row and column."""
    example = ",".join(f"{name}_mm" for name in names)
    table = read_table(path)
    table.refuse_unless_numbers()
    parted = [split_unit(header, "m") for header in table.header]
    columns = []
    for name in names:
        found = [i for i, (header, _) in enumerate(parted) if header == name]
        if len(found) != 1:
            columns_found = listed(table.header)
            raise InputError(
                f"{path}: needs one column for {name}; columns found: {columns_found}; name them {example}"
            )
        unit = parted[found[0]][1]
        columns.append(
            table.quantity(found[0], unit, "m", remedy=lambda: f"name the columns {example}").tolist()
        )
    return tuple(zip(*columns, strict=True))


def dotted(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every key of nested tables and lists with its dotted path; a table in a list stands under its name or
    its kind, if it has one, and the tendon it is for ("terms.tip-gain:left.gain"), else under its number.
    """
    if isinstance(node, dict):
        items = list(node.items())
    else:
        items = [
            (_name_in_list(value, i), value) for i, value in enumerate(node if isinstance(node, list) else ())
        ]
    for key, value in items:
        below = f"{path}.{key}" if path else str(key)
        yield below, value
        yield from dotted(value, below)


def _name_in_list(value: Any, number: int) -> str:
    if not isinstance(value, dict):
        return str(number)
    name, tendon = str(value.get("name", value.get("kind", number))), value.get("tendon")
    return f"{name}:{tendon}" if isinstance(tendon, str) else name


def place_of(part: str, node: Any) -> str | int:
    """Where in a table or a list the next part of a dotted path leads."""
    if isinstance(node, dict):
        return part
    return [_name_in_list(value, i) for i, value in enumerate(node)].index(part)


def find_key(key: str, known: Mapping[str, Any], where: str) -> str:
    """The dotted key meant by a dotted or bare `key`; InputError if none or several are."""
    found = [key] if key in known else [path for path in known if path.endswith(f".{key}")]
    if not found:
        parts = [path.split(".", 1)[-1] for path in known]
        raise InputError(f"{where}: unknown key '{key}'; {did_you_mean(key, [*known, *parts])}")
    if len(found) > 1:
        raise InputError(f"{where}: '{key}' may be any of {listed(found)}; write one of them")
    return found[0]
