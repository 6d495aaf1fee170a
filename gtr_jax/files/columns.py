"""Which columns of a recording hold which quantities, as its user says: `--columns` and mapping files.

`--columns` takes a text, 'T_base=data_0[gf],time=Time[s]', or a mapping file:

    schema = 1
    [columns]
    time = "Time [s]"
    T_base = "data_0 [gf]"
    [clean]
    keep_glitches = false
    drop = ["12.5 s:13 s"]
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from gtr_jax.errors import InputError, did_you_mean, excerpt

from .config_file import read_toml
from .quantities import column_of, plain_name, split_unit, with_tendon
from .sheet import Table
from .whole import write_whole

_EXAMPLE = "'T_base=data_0[gf],time=Time[s]'"


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
    write_whole(path, columns_text(columns, keep_glitches=keep_glitches, drop=drop, note=note))


def mapped(
    table: Table, columns: Columns, wanted: Mapping[str, tuple[str, str]], tendons: Sequence[str]
) -> dict[str, tuple[int, str | None]]:
    """Column index and unit of each quantity that is mapped.

    Args:
        table: the file.
        columns: the mapping.
        wanted: the quantities that there are, as of `quantities_of`.
        tendons: names of several tendons.

    Raises InputError naming the table, the mapping and the entry: an unknown quantity or column, or one that
    stands twice.
    """
    place = f"{table.path}: {columns.place}"
    chosen: dict[str, tuple[int, str | None]] = {}
    for name, source in columns.entries:
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
            raise InputError(f"{place}: {quantity} is mapped twice; keep one")
        si = column_of(wanted[quantity][0]).unit
        unit = None
        if source not in table.header:
            bracketed = re.fullmatch(r"(.*?)\s*\[([^\[\]]*)\]", source)
            source, unit = (bracketed[1], bracketed[2].strip() or None) if bracketed else (source, None)
        if source not in table.header:
            remedy = did_you_mean(source, [name for name in table.header if name])
            raise InputError(f"{place}: no column '{source}' for {quantity}; {remedy}")
        if table.header.count(source) > 1:
            raise InputError(f"{place}: column '{source}' stands twice in the header; rename one")
        index = table.header.index(source)
        other = next((q for q, (i, _) in chosen.items() if i == index), None)
        if other is not None:
            raise InputError(
                f"{place}: column '{source}' is both {other} and {quantity}; take another for one"
            )
        chosen[quantity] = (index, unit or split_unit(source, si)[1])
    return chosen
