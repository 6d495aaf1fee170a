"""Which columns of a recording hold which quantities, as its user says: `--columns` and mapping files.

`--columns` takes a text, 'T_base=data_0[gf],time=Time[s]'. Numbers that have to be converted before a unit
holds, such as raw counts, are written as a product: 'T_base=raw_0*0.00981-1.2[N]', or with a tare in counts
'T_base=(raw_0-84213)/420.5[gf]'. Or it takes a mapping file:

    schema = 1
    [columns]
    time = "Time [s]"
    T_base = "data_0 [gf]"
    [clean]
    keep_glitches = false
    drop = ["12.5 s:13 s"]
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import tomli_w

from gtr_jax.atomic_write import write_atomically
from gtr_jax.config.toml_file import read_toml
from gtr_jax.errors import InputError, did_you_mean, excerpt
from gtr_jax.units import measures

from .formats.quantities import column_of, plain_name, split_unit, with_tendon
from .formats.sheet import Table

_NUMBER = r"[+\-−]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TERM = rf"(?:\s*(?P<{{0}}>[+\-−])\s*(?P<{{1}}>{_NUMBER}))"
_UNIT = r"(?:\s*\[(?P<{0}>[^\[\]]*)\])?"
# raw*0.00981[N]-1.2, (raw-84213)/420.5[gf]: the unit is that of the result, before or after the last term.
_CONVERTED = re.compile(
    rf"(?:\((?P<inner>.+?){_TERM.format('tare_sign', 'tare')}\s*\)|(?P<plain>.+?))"
    rf"\s*(?P<by>[*/])\s*(?P<factor>{_NUMBER}){_UNIT.format('unit')}"
    rf"(?:{_TERM.format('sign', 'offset')}{_UNIT.format('late')})?\s*"
)
_EXAMPLE = "'T_base=data_0[gf],time=Time[s]'"


class Source(NamedTuple):
    """What a quantity is read from: `scale` times the numbers of a column, plus `offset`, in `unit`.

    Attributes:
        index: of the column.
        unit: of the result; None if neither the mapping nor the header says it.
        scale, offset: in that unit.
    """

    index: int
    unit: str | None
    scale: float = 1.0
    offset: float = 0.0

    def named(self, header: str) -> str:
        """The column as a mapping has it, without the unit."""
        if self.scale == 1.0 and self.offset == 0.0:
            return header
        return f"{header}*{self.scale!r}" + (f"{self.offset:+}" if self.offset else "")


@dataclass(frozen=True)
class Columns:
    """What a user says of the columns of a recording.

    Attributes:
        place: where it is said, which errors name: "--columns", or the mapping file.
        entries: quantity, as it is written, and the column's header with its unit in brackets, if any.
        keep_glitches: whether glitches are kept.
        drop: stretches of time that are left out, as "12.5 s:13 s".
    """

    place: str
    entries: tuple[tuple[str, str], ...]
    keep_glitches: bool = False
    drop: tuple[str, ...] = ()


def read_columns(columns: str | os.PathLike[str] | Columns, where: str = "") -> Columns:
    """Read a mapping: a text such as 'T_base=data_0[gf],time=Time[s]', or the path of a mapping file, which
    ends in .toml.

    Args:
        columns: the text or the path; a mapping that is read already comes back as it is.
        where: what the message about a text begins with.

    Raises InputError, in one line, if the text or the file cannot be read, or the file has unknown keys.
    """
    if isinstance(columns, Columns):
        return columns
    if is_file(columns):
        return _of_file(Path(columns))
    entries = []
    for entry in re.split(r",(?=[^,=]*=)", str(columns)):
        name, equals, source = (part.strip() for part in entry.partition("="))
        if not equals or not source:
            raise InputError(f"{where}--columns: cannot read '{entry}'; write for example {_EXAMPLE}")
        entries.append((name, source))
    return Columns("--columns", tuple(entries))


def is_file(columns: str | os.PathLike[str]) -> bool:
    """Whether a value of `--columns` is the path of a mapping file."""
    if not isinstance(columns, str):
        return True
    if not columns.lower().endswith(".toml"):
        return False
    return "=" not in columns or os.path.exists(columns)


def _of_file(path: Path) -> Columns:
    data = read_toml(path)
    _known(path, "", data, ("schema", "columns", "clean"))
    if data.get("schema") != 1 or isinstance(data["schema"], bool):
        raise InputError(f"{path}: schema: must be 1 in a mapping file; write schema = 1 in its first line")
    columns, clean = _section(path, data, "columns"), _section(path, data, "clean")
    entries: list[tuple[str, str]] = []
    for name, source in columns.items():
        parts = source if isinstance(source, dict) else {"": source}  # T_base.left = "cell 1"
        for tendon, text in parts.items():
            quantity = with_tendon(name, tendon)
            if not isinstance(text, str) or not text.strip():
                raise InputError(
                    f"{path}: columns.{quantity}: expected the name of a column, found '{excerpt(text)}'; "
                    f'write for example {quantity} = "data_0 [gf]"'
                )
            entries.append((quantity, text.strip()))
    if not entries:
        raise InputError(f'{path}: columns: names no column; write for example T_base = "data_0 [gf]"')
    _known(path, "clean", clean, ("keep_glitches", "drop"))
    keep, drop = clean.get("keep_glitches", False), clean.get("drop", [])
    if not isinstance(keep, bool):
        raise InputError(f"{path}: clean.keep_glitches: expected true or false, found '{excerpt(keep)}'")
    if not isinstance(drop, list) or not all(isinstance(stretch, str) for stretch in drop):
        raise InputError(
            f"{path}: clean.drop: expected a list of stretches, found '{excerpt(drop)}'; write for example "
            'drop = ["12.5 s:13 s"]'
        )
    return Columns(str(path), tuple(entries), keep, tuple(drop))


def _section(path: Path, data: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = data.get(name, {})
    if not isinstance(section, dict):
        raise InputError(f"{path}: {name}: expected a table of keys and values; write [{name}] above them")
    return section


def _known(path: Path, section: str, data: Mapping[str, Any], known: Sequence[str]) -> None:
    for key in data:
        if key not in known:
            place = f"{path}: {section}" if section else f"{path}"
            raise InputError(f"{place}: unknown key '{excerpt(key)}'; {did_you_mean(str(key), known)}")


def columns_text(
    columns: Mapping[str, str], *, keep_glitches: bool = False, drop: Iterable[str] = (), note: str = ""
) -> str:
    """The text of a mapping file.

    Args:
        columns: the header of each quantity's column, with its unit in brackets where the header has none:
            {"T_base": "data_0 [gf]"}.
        keep_glitches, drop: as of `read_recording`.
        note: lines that stand above as a comment.
    """
    data: dict[str, Any] = {"schema": 1, "columns": dict(columns)}
    clean: dict[str, Any] = {"keep_glitches": True} if keep_glitches else {}
    if stretches := list(drop):
        clean["drop"] = stretches
    if clean:
        data["clean"] = clean
    return "".join(f"# {line}\n" for line in note.splitlines()) + tomli_w.dumps(data)


def write_columns(
    path: str | os.PathLike[str],
    columns: Mapping[str, str],
    *,
    keep_glitches: bool = False,
    drop: Iterable[str] = (),
    note: str = "",
) -> None:
    """Write a mapping file that `--columns` takes, whole or not at all; arguments as of `columns_text`."""
    write_atomically(path, columns_text(columns, keep_glitches=keep_glitches, drop=drop, note=note))


def mapped(
    table: Table, columns: Columns, wanted: Mapping[str, tuple[str, str]], tendons: Sequence[str]
) -> dict[str, Source]:
    """What each quantity that is mapped is read from.

    Args:
        table: the file.
        columns: the mapping.
        wanted: the quantities that there are, as of `quantities_of`.
        tendons: names of several tendons.

    Raises InputError naming the table, the mapping and the entry: an unknown quantity or column, or one that
    is given twice.
    """
    place = f"{table.path}: {columns.place}"
    chosen: dict[str, Source] = {}
    for name, text in columns.entries:
        plain, _, tendon = name.partition(".")
        spelled = next(
            (
                q
                for q, _ in wanted.values()
                if plain_name(plain if tendons else name) in column_of(q).spellings
            ),
            "",
        )
        quantity = f"{spelled}.{tendon}" if tendons and tendon else spelled
        if quantity not in wanted:
            raise InputError(f"{place}: unknown quantity '{name}'; {did_you_mean(name, wanted)}")
        if quantity in chosen:
            raise InputError(f"{place}: {quantity} is mapped twice; remove one")
        source = _source(table, text, column_of(wanted[quantity][0]).unit, place, quantity)
        header = table.header[source.index]
        if table.header.count(header) > 1:
            raise InputError(f"{place}: column '{header}' is in the header twice; rename one")
        other = next((q for q, own in chosen.items() if own.index == source.index), None)
        if other is not None:
            raise InputError(
                f"{place}: column '{header}' is both {other} and {quantity}; take another for one"
            )
        chosen[quantity] = source
    return chosen


def _source(table: Table, text: str, si: str, place: str, quantity: str) -> Source:
    """What the right side of an entry stands for: a header as it is, with a unit, or converted."""
    found = _index(table, text)
    if found is not None:
        return Source(found, _unit(table, found, si))
    bracketed = re.fullmatch(r"(.*?)\s*\[([^\[\]]*)\]", text)
    name, unit = (bracketed[1], bracketed[2].strip() or None) if bracketed else (text, None)
    found = _index(table, name)
    if found is not None:
        return Source(found, unit or _unit(table, found, si))
    converted = _CONVERTED.fullmatch(text)
    if converted is None:
        raise InputError(
            f"{place}: no column '{name}' for {quantity}; {did_you_mean(name, filter(None, table.header))}"
        )
    name = (converted["inner"] or converted["plain"]).strip()
    found = _index(table, name)
    if found is None:
        raise InputError(
            f"{place}: no column '{name}' for {quantity}; {did_you_mean(name, filter(None, table.header))}"
        )
    factor, offset, tare = (_number(converted[part]) for part in ("factor", "offset", "tare"))
    if factor == 0.0:
        raise InputError(f"{place}: {quantity}: a factor of 0 leaves nothing of column '{name}'; correct it")
    scale = factor if converted["by"] == "*" else 1.0 / factor
    offset = _signed(converted["sign"], offset) + scale * _signed(converted["tare_sign"], tare)
    if not (math.isfinite(scale) and math.isfinite(offset)):
        raise InputError(f"{place}: {quantity}: '{excerpt(text)}' is not finite; correct its numbers")
    unit = (converted["unit"] or converted["late"] or "").strip() or None
    return Source(found, unit or _unit(table, found, si), scale, offset)


def _index(table: Table, name: str) -> int | None:
    """The column of this header, as it is or but for the number of its blanks; None if there is none."""
    if name in table.header:
        return table.header.index(name)
    alike = [i for i, header in enumerate(table.header) if header and header.split() == name.split()]
    return alike[0] if len(alike) == 1 else None


def _unit(table: Table, index: int, si: str) -> str | None:
    """The unit that a header states, unless only a row of units states one of the quantity's kind."""
    said, row = split_unit(table.header[index], si)[1], table.unit(index)
    return row if said and row and not measures(said, si) and measures(row, si) else said


def _number(text: str | None) -> float:
    return 0.0 if text is None else float(text.replace("−", "-"))


def _signed(sign: str | None, value: float) -> float:
    return value if sign == "+" else -value if sign else 0.0
