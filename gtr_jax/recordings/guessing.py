"""What the columns of a table may be, guessed without refusing: for somebody to look at and to confirm.

A column is taken for a quantity because its header names it, because the words of its header suggest it, or,
where no header does, because of its numbers: a clock only rises; of two columns that rise and fall together
the larger is the tension at the base and the smaller that at the tip.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gtr_jax.errors import InputError
from gtr_jax.units import measures

from .formats.headers import (
    RARE_NEWTONS,
    RAW,
    force_meant,
    is_clock,
    may_be_force,
    meant_column,
    recognised,
    says_force,
    words_of,
)
from .formats.quantities import COLUMNS, NEEDED, quantities_of, split_unit
from .formats.sheet import Table

HEADER, UNITS, NAME, SIZE, NOTHING = "header", "row of units", "name", "size", "nothing"
_SURE = (HEADER, UNITS)
_TOGETHER = 0.5  # correlation of two columns from which they may be both ends of one tendon
_TAILS = (0.5, 99.5)  # percentiles between which a column is looked at: a glitch is not a size
_LOOKED_AT = 20_000  # samples of a column that are looked at


@dataclass(frozen=True)
class Guessed:
    """The column that a quantity is guessed to be in.

    Attributes:
        quantity: name of the quantity, as "T_base" or "T_base.left".
        header, index: of the column.
        unit: the column's unit; None of time stamps.
        found: why this column: "header" (it names the quantity), "name" (its words suggest it), or "size".
        unit_found: why this unit: "header", "row of units", "name" (a word for it, as kg), "size", or
            "nothing", where it is taken as SI.
        notes: what to know before using it, as that counts are not a force.
    """

    quantity: str
    header: str
    index: int
    unit: str | None
    found: str
    unit_found: str
    notes: tuple[str, ...] = ()

    @property
    def sure(self) -> bool:
        """Whether the file itself says both, and nothing speaks against it."""
        return self.found == HEADER and self.unit_found in _SURE and not self.notes

    @property
    def source(self) -> str:
        """The right side of a mapping: the header, with the unit in brackets where it must be said."""
        si = COLUMNS[self.quantity.partition(".")[0]].unit
        if self.unit is None or split_unit(self.header, si)[1] == self.unit:
            return self.header
        return f"{self.header} [{self.unit}]"

    @property
    def says(self) -> str:
        """The guess and its reasons, in one sentence."""
        why = {HEADER: "the header names it", NAME: "guessed from the words of the header"}
        unit = {
            HEADER: f"{self.unit}: the header says so",
            UNITS: f"{self.unit}: the row of units says so",
            NAME: f"{self.unit}: guessed from the word in the header",
            SIZE: f"{self.unit}: guessed from the size of the numbers",
            NOTHING: f"{self.unit}: nothing says otherwise",
        }
        told = why.get(self.found, "guessed from its numbers")
        in_unit = "time stamps" if self.unit is None else unit[self.unit_found]
        return "; ".join([f"{self.quantity} = '{self.header}' ({told}; {in_unit})", *self.notes])


@dataclass(frozen=True)
class Guess:
    """What the columns of a table may be.

    Attributes:
        quantities: the guesses by quantity, in the order of COLUMNS.
        missing: quantities that are needed, T_base and T_tip, and that no column suggests.
        unused: headers of the other columns.
        notes: what to know, a sentence each.
    """

    quantities: Mapping[str, Guessed] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def columns(self) -> dict[str, str]:
        """The mapping, as `columns_text` takes it."""
        return {name: guessed.source for name, guessed in self.quantities.items()}


def guess(table: Table, tendons: Sequence[str] = ()) -> Guess:
    """Guess which column holds which quantity, in which unit, and why; nothing is refused.

    Args:
        table: the file.
        tendons: names of the tendons, if the robot has several.
    """
    notes: list[str] = []
    found: dict[str, tuple[int, str]] = {}
    for key, (quantity, tendon) in quantities_of(tendons).items():
        try:
            entry = recognised(table, quantity, tendon)
        except InputError as fault:
            notes.append(str(fault).removeprefix(f"{table.path}: "))
            continue
        if entry is not None and _usable(table, entry[0]) and _nameable(table, entry[0]):
            found[key] = (entry[0], HEADER)
    for key, (quantity, tendon) in quantities_of(tendons).items():
        if key not in found and quantity in ("time", *NEEDED):
            index = meant_column(table, quantity, tendon, tendons)
            fits = index is not None and index not in _taken(found) and _nameable(table, index)
            if index is not None and fits and (quantity == "time" or not _counts(table, index)):
                found[key] = (index, NAME)
    numbers = _numbers(table, _taken(found))
    if "time" not in found:
        index = _clock(table, numbers)
        if index is not None:
            found["time"] = (index, SIZE)
            numbers.pop(index)
    if not tendons:
        found |= _ends(table, numbers, found)
    order = [key for key in quantities_of(tendons) if key in found]
    quantities = {key: _with_unit(table, key, *found[key]) for key in order}
    needed = tuple(key for key, (q, _) in quantities_of(tendons).items() if q in NEEDED and key not in found)
    others = [header for i, header in enumerate(table.header) if header and i not in _taken(found)]
    return Guess(quantities, needed, tuple(others), tuple(notes))


def _taken(found: Mapping[str, tuple[int, str]]) -> set[int]:
    return {index for index, _ in found.values()}


def _nameable(table: Table, index: int) -> bool:
    """Whether a mapping can name the column: its header is not empty and stands once."""
    return bool(table.header[index]) and table.header.count(table.header[index]) == 1


def _usable(table: Table, index: int) -> bool:
    return table.has_numbers(index) or table.has_times(index)


def _numbers(table: Table, taken: set[int]) -> dict[int, np.ndarray]:
    """Columns of numbers that are not taken and that change, at most _LOOKED_AT of their samples."""
    found = {}
    for index in range(len(table.header)):
        if index in taken or not _nameable(table, index) or not table.has_numbers(index):
            continue
        try:
            values = table.column(index, most_absent=1.0)
        except InputError:
            continue
        values = values[:: max(len(values) // _LOOKED_AT, 1)]
        if np.isfinite(values).sum() > 1 and np.ptp(values[np.isfinite(values)]) > 0:
            found[index] = values
    return found


def _counts(table: Table, index: int) -> bool:
    """Whether a column numbers its rows."""
    x = _numbers(table, {*range(len(table.header))} - {index}).get(index, np.zeros(0))
    return len(x) > 2 and bool(np.all(np.diff(x) > 0)) and float(np.ptp(np.diff(x))) == 0.0


def _clock(table: Table, numbers: Mapping[int, np.ndarray]) -> int | None:
    """The one column that only rises, or repeats its stamps, and is not a number of the sample."""
    rising = [
        i
        for i, x in numbers.items()
        if len(x) > 2 and not says_force(table, i) and (np.all(np.diff(x) > 0) or is_clock(x))
    ]
    counted = [i for i in rising if np.all(np.diff(numbers[i]) == 1)]
    fit = [i for i in rising if i not in counted] or [i for i in rising if _says(table, i, "s")]
    return fit[0] if len(fit) == 1 else None


def _says(table: Table, index: int, si: str) -> bool:
    said = split_unit(table.header[index], si)[1] or table.unit(index)
    return said is not None and measures(said, si)


def _ends(
    table: Table, numbers: Mapping[int, np.ndarray], found: Mapping[str, tuple[int, str]]
) -> dict[str, tuple[int, str]]:
    """Both tensions, or the one that is missing, by size: the two that rise and fall together most."""
    absent = [name for name in NEEDED if name not in found]
    if not absent:
        return {}
    columns = {
        i: x for i, x in numbers.items() if may_be_force(table, i) and _pulls(x, said=says_force(table, i))
    }
    for name in NEEDED:
        if name in found:
            x = table.column(found[name][0], most_absent=1.0)
            columns[found[name][0]] = x[:: max(len(x) // _LOOKED_AT, 1)]
    sizes = {i: float(np.nanpercentile(x, _TAILS[1])) for i, x in columns.items()}
    pairs = [
        (_together(columns[a], columns[b]), a, b)
        for a in columns
        for b in columns
        if sizes[a] > sizes[b] > 0 and _placed(found, a, b)
    ]
    close, base, tip = max(pairs, default=(0.0, -1, -1))
    if close < _TOGETHER:
        return {}
    return {name: (index, SIZE) for name, index in (("T_base", base), ("T_tip", tip)) if name in absent}


def _pulls(x: np.ndarray, *, said: bool) -> bool:
    """Whether numbers may be tensions: above zero they reach farther than below, and they are not a clock,
    unless their header has `said` that they are forces, which a steady pull raises as evenly.
    """
    low, high = np.nanpercentile(x, [_TAILS[0], _TAILS[1]])
    return (said or not (np.all(np.diff(x) > 0) or is_clock(x))) and bool(high > -low)


def _placed(found: Mapping[str, tuple[int, str]], base: int, tip: int) -> bool:
    """Whether a pair agrees with the end that is known."""
    return all(found[n][0] == i for n, i in (("T_base", base), ("T_tip", tip)) if n in found)


def _together(a: np.ndarray, b: np.ndarray) -> float:
    """Correlation of two columns between their tails."""
    both = np.isfinite(a) & np.isfinite(b)
    x, y = (np.clip(v[both], *np.percentile(v[both], _TAILS)) if both.any() else v[both] for v in (a, b))
    if len(x) < 3 or np.ptp(x) == 0 or np.ptp(y) == 0:
        return 0.0
    return float(np.corrcoef(x, y)[0, 1])


def _with_unit(table: Table, key: str, index: int, why: str) -> Guessed:
    """The column with its unit, and why it is that."""
    quantity = key.partition(".")[0]
    si, header = COLUMNS[quantity].unit, table.header[index]
    if si == "s" and not table.has_numbers(index):
        return Guessed(key, header, index, None, why, HEADER)
    if si == "dimensionless":
        return Guessed(key, header, index, si, why, HEADER)
    for said, place in (
        (split_unit(header, si)[1], HEADER),
        (table.unit(index), UNITS),
        (re.split(r"[\s_]+", header)[-1] if re.search(r"[\s_]", header) else None, NAME),
    ):
        if said is None:
            continue
        word = said.strip("[]() ")
        if measures(word, si):
            return Guessed(key, header, index, word, why, place)
        if si == "N" and measures(force_meant(word), si):
            note = f"'{word}' is a mass: its weight is meant"
            return Guessed(key, header, index, force_meant(word), why, NAME, (note,))
        if si == "N" and word.lower() in RAW:
            return Guessed(key, header, index, word, why, place, (_uncalibrated(key, header, word),))
    unit, place = si, NOTHING
    raw = next((word for word in words_of(header) if RAW.get(word) == "raw counts"), None)
    if si == "N" and raw and _whole(table, index):
        return Guessed(key, header, index, raw, why, NAME, (_uncalibrated(key, header, raw),))
    if si == "N" and _size(table, index) > RARE_NEWTONS:
        unit, place = "gf", SIZE
    elif si == "rad" and _size(table, index) > 2 * np.pi:
        unit, place = "deg", SIZE
    elif si == "s" and _ticks(table, index) > 1.0:
        unit, place = "ms", SIZE
    elif si == "m" and _size(table, index) > 10.0:
        unit, place = "mm", SIZE
    return Guessed(key, header, index, unit, why, place)


def _uncalibrated(key: str, header: str, unit: str) -> str:
    """What to do about a column in a unit that is not a force's."""
    bare = split_unit(header, "N")[0] if header.endswith(")") else header
    return (
        f"'{header}' holds {RAW[unit.lower()]}, no force: calibrate the cell and say how it is converted, "
        f"for example --columns '{key}={bare}*0.0098-1.2[N]'"
    )


def _whole(table: Table, index: int) -> bool:
    """Whether a column holds whole numbers only."""
    try:
        values = table.column(index, most_absent=1.0)
    except InputError:
        return False
    values = values[np.isfinite(values)]
    return bool(values.size) and bool(np.all(values == np.round(values)))


def _size(table: Table, index: int) -> float:
    """The size of a column's numbers, glitches left out."""
    try:
        values = np.abs(table.column(index, most_absent=1.0))
    except InputError:
        return 0.0
    return float(np.nanpercentile(values, _TAILS[1])) if np.isfinite(values).any() else 0.0


def _ticks(table: Table, index: int) -> float:
    """The median interval of a clock; 0 if it has none."""
    try:
        values = np.diff(table.column(index, most_absent=1.0))
    except InputError:
        return 0.0
    return float(np.nanmedian(values)) if np.isfinite(values).any() else 0.0
