"""Recordings: CSV files of tendon tensions at the base and the tip, read and written in SI units.

A header row, then rows in time order; the order of the rows is the load history. Every fault is reported
with the row number that an editor shows. What a CSV file may look like is in `table`.
"""

from __future__ import annotations

import csv
import difflib
import functools
import io
import itertools
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gtr_jax.errors import InputError, did_you_mean, listed

from .table import Table, is_data, read_table
from .units import measures

SWAP_FACTOR = 1.3
"""A tip tension peaking above this multiple of the base's suggests swapped columns or wrong units."""


class Column(NamedTuple):
    """One quantity of a recording: its SI unit, the header it is written under, and other spellings."""

    unit: str
    header: str
    spellings: frozenset[str]


# Spellings are compared in lower case without spaces, dots, underscores and hyphens.
COLUMNS = {
    "time": Column("s", "time_s", frozenset({"time", "t", "timestamp"})),
    "T_base": Column("N", "T_base_N", frozenset({"tbase", "basetension", "tensionbase", "tproximal"})),
    "T_tip": Column("N", "T_tip_N", frozenset({"ttip", "tiptension", "tensiontip", "tdistal"})),
    "tip_x": Column("m", "tip_x_m", frozenset({"tipx", "xtip"})),
    "tip_y": Column("m", "tip_y_m", frozenset({"tipy", "ytip"})),
    "tip_angle": Column("rad", "tip_angle_rad", frozenset({"tipangle", "angletip", "phitip"})),
    "displacement": Column("m", "displacement_m", frozenset({"displacement", "tendondisplacement"})),
    "trial": Column("dimensionless", "trial", frozenset({"trial"})),
}
NEEDED = ("T_base", "T_tip")
PER_TENDON = ("T_base", "T_tip", "displacement")
# Units known as a header's ending, as in T_base_gf; in brackets, as in Tbase [gf], any unit is known.
_HEADER_ENDINGS = {
    "s": ("s", "ms", "us", "min"),
    "N": ("N", "mN", "kN", "gf", "kgf", "lbf"),
    "m": ("m", "mm", "cm", "um"),
    "rad": ("rad", "mrad", "deg"),
}


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording in SI units: read-only float64 arrays, one value per row; None where not recorded.

    T_base and T_tip [N], time [s], tip_x and tip_y [m], tip_angle [rad] against the base tangent,
    displacement [m] of the tendon pulled out at the base, and the number of the trial. Of several tendons,
    named in `tendons`, T_base, T_tip and displacement are (rows, tendons).
    """

    T_base: np.ndarray
    path: Path
    sha256: str
    T_tip: np.ndarray | None = None
    time: np.ndarray | None = None
    tip_x: np.ndarray | None = None
    tip_y: np.ndarray | None = None
    tip_angle: np.ndarray | None = None
    displacement: np.ndarray | None = None
    trial: np.ndarray | None = None
    tendons: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.T_base)


def write_whole(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file whole or not at all: into a temporary file beside it, which then takes its name."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        temporary.write_text(text, encoding="utf-8", newline="")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _plain(name: str) -> str:
    return re.sub(r"[\s._-]", "", name).lower()


def split_unit(header: str, si: str) -> tuple[str, str | None]:
    """Part a header into name and unit: "Tbase [gf]", "Tbase (gf)" or "T_base_gf"; None without a unit."""
    bracketed = re.fullmatch(r"(.*?)\s*[\[(]([^\[\]()]*)[\])]", header)
    if bracketed:
        return bracketed[1], bracketed[2].strip() or None
    name, _, ending = header.replace(" ", "_").rpartition("_")
    return (name, ending) if name and ending in _HEADER_ENDINGS.get(si, ()) else (header, None)


def _wanted(tendons: Sequence[str]) -> dict[str, tuple[str, str]]:
    """What may be read: the quantity and the tendon ("" for none) under each name, such as "T_base.left"."""
    wanted = {}
    for quantity in COLUMNS:
        names = tendons if quantity in PER_TENDON and tendons else ("",)
        wanted |= {f"{quantity}.{name}" if name else quantity: (quantity, name) for name in names}
    return wanted


def _mapped(table: Table, columns: str, tendons: Sequence[str]) -> dict[str, tuple[int, str | None]]:
    """Column index and unit per quantity, from 'T_base=data_0[gf],T_tip=data_2[gf],time=Time[s]'."""
    wanted = _wanted(tendons)
    place = f"{table.path}: --columns"
    chosen: dict[str, tuple[int, str | None]] = {}
    for entry in re.split(r",(?=[^,=]*=)", columns):
        name, equals, source = (part.strip() for part in entry.partition("="))
        if not equals or not source:
            raise InputError(
                f"{place}: cannot read '{entry}'; write for example 'T_base=data_0[gf],time=Time[s]'"
            )
        plain, _, tendon = name.partition(".")
        spelled = next(
            (q for q, c in COLUMNS.items() if _plain(plain if tendons else name) in c.spellings), ""
        )
        quantity = f"{spelled}.{tendon}" if tendons and tendon else spelled
        if quantity not in wanted:
            raise InputError(f"{place}: unknown quantity '{name}'; {did_you_mean(name, wanted)}")
        if quantity in chosen:
            raise InputError(f"{place}: {quantity} is mapped twice; keep one")
        si = COLUMNS[wanted[quantity][0]].unit
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


def _of_tendon(header: str, tendon: str) -> str | None:
    """The header without the name of a tendon ("T_base_N" of "T_base_N.left"); None if it has another."""
    if not tendon:
        return header
    found = re.fullmatch(rf"(.*?)\.{re.escape(tendon)}(\s*[\[(].*)?", header)
    return f"{found[1]}{found[2] or ''}" if found else None


def _recognised(table: Table, quantity: str, tendon: str) -> tuple[int, str | None] | None:
    """Column index and unit of a quantity from the headers themselves; None if no header names it."""
    si, canonical, spellings = COLUMNS[quantity]
    canonical = f"{canonical}.{tendon}" if tendon else canonical
    found: list[tuple[int, str | None]] = []
    for index, header in enumerate(table.header):
        own = _of_tendon(header, tendon)
        if own is None:
            continue
        name, unit = split_unit(own, si)
        if _plain(name) in spellings and name != "T":  # a bare T may be a tension, a time, a temperature
            found.append((index, unit))
    exact = [entry for entry in found if table.header[entry[0]] == canonical]
    found = exact or found
    if quantity not in NEEDED:  # a column of words, "trial B", is of no use and in nobody's way
        able = [table.has_numbers(index) for index, _ in found]
        if quantity == "time" and not any(able):
            able = [table.has_times(index) for index, _ in found]
        found = list(itertools.compress(found, able))
    if len(found) > 1:
        names = " and ".join(f"'{table.header[index]}'" for index, _ in found)
        first = table.header[found[0][0]]
        alike = any(table.header[index] == first for index, _ in found[1:])
        remedy = f"choose one with --columns '{_dot(quantity, tendon)}={first}' or rename the others"
        raise InputError(
            f"{table.path}: {names} all name {_dot(quantity, tendon)}; {'rename one' if alike else remedy}"
        )
    return found[0] if found else None


def _dot(name: str, tendon: str) -> str:
    return f"{name}.{tendon}" if tendon else name


def _missing(table: Table, absent: Sequence[str], tendons: Sequence[str]) -> InputError:
    """The error for quantities that are needed and have no column: what may be meant, and in which unit."""
    wanted = _wanted(tendons)
    quantity, tendon = wanted[absent[0]]
    column = COLUMNS[quantity]
    names = [header for header in table.header if header]
    place = f"{table.path}: no column {_dot(column.header, tendon)}"
    if tendon and _recognised(table, quantity, "") is not None:
        return InputError(
            f"{place}, but one for a single tendon; of several, {listed(tendons)}, each one's columns end "
            f"with its name: {column.header}.{tendon}"
        )
    ended = [header for header in names if re.match(rf"{re.escape(column.header)}\.\w", header)]
    if not tendon and ended:
        names = [header.rpartition(".")[2] for header in ended]
        return InputError(
            f"{place}, but {listed(ended)} of several tendons; for one tendon rename its column to "
            f"{column.header}; several are named in the robot file, as [[tendons]], or in Python, "
            f"read_recording(..., tendons=({', '.join(map(repr, names))}))"
        )
    if len(table.rows) and is_data(table.header):
        return InputError(
            f"{table.path}: the first row holds numbers; put the names of the columns above, "
            "for example time_s,T_base_N,T_tip_N"
        )
    meant = {key: _meant(table, *wanted[key], tendons) for key in absent}
    entries = []
    for key, index in meant.items():
        si = COLUMNS[wanted[key][0]].unit
        name, unit = ("NAME", si) if index is None else (table.header[index], _unit_meant(table, index, si))
        entries.append(f"{key}={name}[{unit}]")
    near = meant[absent[0]]
    return InputError(
        f"{place}; columns found: {listed(names)}"
        + ("" if near is None else f" (nearest: '{table.header[near]}')")
        + f"; rename one, or add --columns '{','.join(entries)}'"
    )


# Words in headers that tell the end of the tendon, that speak for a tension, and that speak against it.
_SIDES = {
    "T_base": ("base", "prox", "proximal", "motor", "input", "drive", "actuator", "handle"),
    "T_tip": ("tip", "dist", "distal", "end", "output"),
}
_FORCES = frozenset("t f tension force load cell loadcell tendon cable n gf g kg newton".split())
_NO_FORCES = frozenset(
    "angle bend bending time clock temp temperature x y z pos position displacement disp stroke voltage volt "
    "v strain s ms m mm deg rad trial sample index".split()
)
_ALIKE = 0.7  # of a misspelt header to one that is known
# Words for units of tension, and the unit meant.
_MEANT = {"g": "gf", "gr": "gf", "gram": "gf", "grams": "gf", "kg": "kgf", "lb": "lbf", "lbs": "lbf"}
_RARE_NEWTONS = 300.0  # beyond, a tension without a unit is rather in grams-force


def _meant(table: Table, quantity: str, tendon: str, tendons: Sequence[str]) -> int | None:
    """The column that may be a quantity under a name that is not known; None if none suggests itself."""
    spellings = {s: q for q, column in COLUMNS.items() for s in column.spellings}
    si = COLUMNS[quantity].unit
    others = [other for other in tendons if other != tendon]
    sides = {word: q for q, words in _SIDES.items() for word in words}
    scores: dict[int, float] = {}
    for index, header in enumerate(table.header):
        own = _of_tendon(header, tendon) or header
        name = _plain(split_unit(own, si)[0])
        if not header or any(_of_tendon(header, other) for other in others) or not table.has_numbers(index):
            continue
        if spellings.get(name, quantity) != quantity:
            continue  # it is another quantity
        words = [w.lower() for w in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", header)]
        score = 1.0 if quantity in NEEDED and _FORCES.intersection(words) else 0.0
        for word, side in sides.items():
            if quantity in NEEDED and any(w.startswith(word) or w.endswith(word) for w in words):
                score += 2.0 if side == quantity else -9.0
        score -= 9.0 * len(_NO_FORCES.intersection(words)) * (quantity in NEEDED)
        alike = [difflib.SequenceMatcher(None, name, s).ratio() for s in COLUMNS[quantity].spellings]
        score += 3.0 * max(alike) if max(alike) > _ALIKE else 0.0
        if score > 0:
            scores[index] = score
    best = [index for index, score in scores.items() if score == max(scores.values())]
    return best[0] if len(best) == 1 else None


def _with_unit(table: Table, key: str, index: int, si: str) -> str:
    """What to add to the command for a column whose unit is not understood."""
    return f"give its unit with --columns '{key}={table.header[index]}[{_unit_meant(table, index, si)}]'"


def _unit_meant(table: Table, index: int, si: str) -> str:
    """The unit that a column is likely to be in: as its header or a row of units has it, for tensions with
    the force for the mass; grams-force where newtons would be many.
    """
    header = table.header[index]
    ending = re.split(r"[\s_]+", header)[-1]
    for said in (split_unit(header, si)[1], table.unit(index), ending):
        word = "" if said is None else said.strip("[]() ")
        word = _MEANT.get(word.lower(), word) if si == "N" else word
        if measures(word, si):
            return word
    try:
        large = si == "N" and float(np.max(np.abs(table.column(index)))) > _RARE_NEWTONS
    except InputError:
        large = False
    return "gf" if large else si


def read_recording(
    path: str | os.PathLike[str],
    columns: str | None = None,
    *,
    need_tip: bool = True,
    tendons: Sequence[str] = (),
) -> Recording:
    """Read a recording (or a base-tension history) from a CSV file.

    Args:
        path: the file; its header names the quantities and their units (COLUMNS), SI where none is given.
        columns: columns under other names, as 'T_base=data_0[gf],T_tip=data_2[gf],time=Time[s]'; the
            quantities it leaves out are still looked for in the header. Columns of no use are ignored.
        need_tip: whether a file without a tip tension is refused.
        tendons: names of the tendons, if the robot has several: then T_base, T_tip and displacement are
            looked for as T_base_N.left and the like, for all of them or none, and are (rows, tendons).

    Raises InputError naming file, row, column and remedy: see `read_table`; missing or doubtful columns,
    unknown units, cells that are no number, time going backwards, tensions of reversed sign, and a tip
    tension that peaks more than SWAP_FACTOR above the base's. Small negative readings are noise and kept.
    """
    table = read_table(path)
    chosen = _mapped(table, columns, tendons) if columns is not None else {}
    taken = {index for index, _ in chosen.values()}
    wanted = _wanted(tendons)
    for key, (quantity, tendon) in wanted.items():
        found = None if key in chosen else _recognised(table, quantity, tendon)
        if found and found[0] not in taken:
            chosen[key] = found
    begun = {wanted[key][0] for key in chosen}
    needed = NEEDED if need_tip else NEEDED[:1]
    absent = [
        key
        for key, (quantity, tendon) in wanted.items()
        if key not in chosen and (quantity in needed or (tendon and quantity in begun))
    ]
    if absent:
        raise _missing(table, absent, tendons)
    data = {}
    for key, (quantity, _) in wanted.items():
        if key in chosen:
            index, unit = chosen[key]
            si = COLUMNS[quantity].unit
            remedy = functools.partial(_with_unit, table, key, index, si)
            data[key] = table.quantity(index, unit, si, remedy=remedy)
    headers = {key: table.header[index] for key, (index, _) in chosen.items()}
    for name in tendons or ("",):
        own = [key for key, (_, tendon) in wanted.items() if key in data and tendon in ("", name)]
        signals = {wanted[key][0]: data[key] for key in own}
        _check_signals(table, signals, {wanted[key][0]: headers[key] for key in own}, alone=not tendons)
    return Recording(
        **_by_quantity(data, tendons), path=table.path, sha256=table.sha256, tendons=tuple(tendons)
    )


def _by_quantity(data: Mapping[str, np.ndarray], tendons: Sequence[str]) -> dict[str, np.ndarray]:
    """Columns by quantity; those of several tendons side by side."""
    out = {key: values for key, values in data.items() if "." not in key}
    for quantity in PER_TENDON if tendons else ():
        columns = [data[f"{quantity}.{name}"] for name in tendons if f"{quantity}.{name}" in data]
        if columns:
            out[quantity] = np.stack(columns, axis=1)
            out[quantity].setflags(write=False)
    return out


def _check_signals(
    table: Table, data: Mapping[str, np.ndarray], headers: Mapping[str, str], *, alone: bool
) -> None:
    """Refuse what no recording of a pulled tendon shows: backward time, pushing tendons, and, unless others
    may drag it, swapped cells.
    """
    if "time" in data:
        backwards = np.flatnonzero(np.diff(data["time"]) < 0)
        if backwards.size:
            i = backwards[0]
            raise InputError(
                f"{table.path}: row {table.numbers[i + 1]}, column '{headers['time']}': "
                f"time goes backwards, from {data['time'][i]:.6g} s to {data['time'][i + 1]:.6g} s; "
                "put the rows in time order, or give each trial its own file"
            )
    base_peak = float(np.max(data["T_base"]))
    for quantity in ("T_base", "T_tip"):
        if quantity not in data:
            continue
        row = int(np.argmin(data[quantity]))
        lowest, highest = float(data[quantity][row]), float(np.max(data[quantity]))
        # A tip cell that hardly sees tension may dwell below zero; a reversed one mirrors the pull.
        if lowest < 0 and -lowest > max(highest, 0.1 * base_peak if quantity == "T_tip" else 0.0):
            raise InputError(
                f"{table.path}: row {table.numbers[row]}, column '{headers[quantity]}': {quantity} peaks at "
                f"{lowest:.4g} N, but a tendon only pulls; reverse the sign of the column"
            )
    if alone and "T_tip" in data:
        row = int(np.argmax(data["T_tip"]))
        tip_peak = float(data["T_tip"][row])
        if tip_peak > SWAP_FACTOR * base_peak:
            raise InputError(
                f"{table.path}: row {table.numbers[row]}, column '{headers['T_tip']}': "
                f"T_tip peaks at {tip_peak:.4g} N and T_base at {base_peak:.4g} N; "
                "columns swapped or units mixed? check --columns 'T_base=NAME[unit],T_tip=NAME[unit]'"
            )


def write_recording(
    path: str | os.PathLike[str],
    recording: Recording | Mapping[str, Iterable[float] | Sequence[str]],
    *,
    tendons: Sequence[str] = (),
) -> None:
    """Write a recording, or columns by name, as a CSV file that `read_recording` reads back exactly.

    The quantities of COLUMNS (SI) come first, under their headers with units; further columns follow under
    the names they are given, which should carry their unit. None is left out. A quantity of several tendons,
    (rows, tendons), becomes a column for each of `tendons`, ending with its name. The file is written whole
    or not at all.

    Raises ValueError if the columns differ in length.
    """
    if isinstance(recording, Recording):
        given = {field.name: getattr(recording, field.name) for field in fields(recording)}
        named = {quantity: given[quantity] for quantity in COLUMNS}
        tendons = recording.tendons
    else:
        named = {quantity: recording.get(quantity) for quantity in COLUMNS}
        named |= {name: values for name, values in recording.items() if name not in COLUMNS}
    columns = {}
    for name, values in named.items():
        if values is None:
            continue
        header, table = COLUMNS[name].header if name in COLUMNS else name, np.asarray(values)
        if table.ndim == 1:
            columns[header] = table.tolist()
        else:
            columns |= {f"{header}.{t}": own.tolist() for t, own in zip(tendons, table.T, strict=True)}
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    write_whole(path, stream.getvalue())
