"""Which column of a table holds which quantity, by its header; what is meant where no header says it."""

from __future__ import annotations

import difflib
import itertools
import re
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from gtr_jax.errors import InputError, listed
from gtr_jax.units import DIMENSIONS, measures

from .quantities import COLUMNS, NEEDED, PER_TENDON, column_of, of_tendon, plain_name, split_unit, with_tendon
from .sheet import Table


def recognised(table: Table, quantity: str, tendon: str) -> tuple[int, str | None] | None:
    """Column index and unit of a quantity from the headers themselves; None if no header names it."""
    si, canonical, spellings = column_of(quantity)
    canonical = f"{canonical}.{tendon}" if tendon else canonical
    found: list[tuple[int, str | None]] = []
    for index, header in enumerate(table.header):
        own = of_tendon(header, tendon)
        if own is None:
            continue
        name, unit = split_unit(own, si)
        if plain_name(name) in spellings and name != "T":  # a bare T may be a tension, a time, a temperature
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
        remedy = f"choose one with --columns '{with_tendon(quantity, tendon)}={first}' or rename the others"
        remedy = "rename one" if alike else remedy
        raise InputError(f"{table.path}: {names} all name {with_tendon(quantity, tendon)}; {remedy}")
    return found[0] if found else None


def missing(
    table: Table,
    absent: Sequence[str],
    wanted: Mapping[str, tuple[str, str]],
    tendons: Sequence[str],
    *,
    guessed: Mapping[str, str],
) -> InputError:
    """The error for quantities that are needed and have no column: what may be meant, and in which unit.

    Args:
        table: the file.
        absent: their names.
        wanted: what may be read, as of `quantities_of`.
        tendons: names of several tendons.
        guessed: what their columns may be by their numbers, as a mapping has it: "column 2[N]".
    """
    quantity, tendon = wanted[absent[0]]
    column = column_of(quantity)
    names = [header for header in table.header if header]
    place = f"{table.path}: no column {with_tendon(column.header, tendon)}"
    if tendon and recognised(table, quantity, "") is not None:
        return InputError(
            f"{place}, but one for a single tendon; of several, {listed(tendons)}, each one's columns end "
            f"with its name: {column.header}.{tendon}"
        )
    ended = [header for header in names if re.match(rf"{re.escape(column.header)}\.\w", header)]
    if not tendon and ended:
        names = [header.rpartition(".")[2] for header in ended]
        heads = "|".join(re.escape(column_of(q).header) for q in PER_TENDON)
        tendon_names = {h.rpartition(".")[2] for h in table.header if re.match(rf"({heads})\.\w", h)}
        if len(tendon_names) == 1:
            return InputError(
                f"{place}, but '{ended[0]}'; a robot's one tendon carries no name: rename the column to "
                f"{column.header}, and likewise others that end with .{names[0]}"
            )
        return InputError(
            f"{place}, but {listed(ended)} of several tendons; for one tendon rename its column to "
            f"{column.header}; several are named in the robot file, as [[tendons]], or in Python, "
            f"read_recording(..., tendons=({', '.join(map(repr, names))}))"
        )
    meant: dict[str, int | None] = {}
    for key in absent:
        taken = [index for index in meant.values() if index is not None]
        meant[key] = meant_column(table, *wanted[key], tendons, taken=taken)
    entries = []
    for key, index in meant.items():
        si = column_of(wanted[key][0]).unit
        named = f"NAME[{si}]" if index is None else f"{table.header[index]}[{unit_meant(table, index, si)}]"
        entries.append(f"{key}={guessed.get(key, named) if index is None else named}")
    if table.numbered:
        # What is not guessed is an example: clocks come first.
        places = iter(table.header[min(len(table.header) - 1, 1) if len(table.header) > len(absent) else 0 :])
        entries = [e.replace("=NAME[", f"={next(places, 'NAME')}[") for e in entries]
        entries += [f"{key}={text}" for key, text in guessed.items() if key not in absent]
        return InputError(
            f"{table.path}: has no header, so that its columns are numbered: {listed(names)}; put their "
            f"names above, for example time_s,T_base_N,T_tip_N, or say which they are, for example "
            f"--columns '{','.join(entries)}'"
        )
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
FORCES = frozenset("t f tension force load cell loadcell tendon cable n gf g kg newton".split())
_SURE_FORCES = frozenset("tension force load cell loadcell newton".split())  # beyond doubt
_NO_FORCES = frozenset(
    "angle bend bending time clock temp temperature x y z pos position displacement disp stroke voltage volt "
    "v strain s ms m mm deg rad trial sample index".split()
)
_COUNTERS = frozenset("n no nr num number step cycle row".split())  # n_load counts the loads
# Readings of an amplifier that are not forces until they are calibrated.
RAW = {
    "counts": "raw counts",
    "count": "raw counts",
    "cnt": "raw counts",
    "adc": "raw counts",
    "raw": "raw counts",
    "lsb": "raw counts",
    "bits": "raw counts",
    "v": "a voltage",
    "mv": "a voltage",
    "volt": "a voltage",
    "volts": "a voltage",
    "mv/v": "a ratio of voltages",
}
# A clock, whatever its name, never falls, and nine in ten of its steps are its median step to half of it.
_EVEN, _MOSTLY, _STEPS = 0.5, 0.9, 10
_ALIKE = 0.7  # of a misspelt header to one that is known
# Words for units of tension, and the unit meant.
_MEANT = {"g": "gf", "gr": "gf", "gram": "gf", "grams": "gf", "kg": "kgf", "lb": "lbf", "lbs": "lbf"}
RARE_NEWTONS = 300.0  # beyond, a tension without a unit is rather in grams-force


def words_of(header: str) -> list[str]:
    """The words of a header in lower case: "TipForce_N" has tip, force and n."""
    return [w.lower() for w in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", header)]


def force_meant(unit: str) -> str:
    """The unit of force that a unit of mass stands for; the unit itself if it is none."""
    return _MEANT.get(unit.lower(), unit)


def is_clock(x: np.ndarray) -> bool:
    """Whether numbers, (K,), are those of a clock or a counter, which may repeat its stamps: they never fall,
    and rise by even steps.
    """
    steps = np.diff(x[np.isfinite(x)])
    rises = steps[steps > 0]
    if len(rises) < _STEPS or np.any(steps < 0):
        return False
    usual = float(np.median(rises))
    return float(np.mean(np.abs(rises - usual) <= _EVEN * usual)) >= _MOSTLY


def says_force(table: Table, index: int) -> bool:
    """Whether a column says that it is a force: by its unit, or by its name where it gives no other unit."""
    said = said_unit(table, index)
    if said is not None and said.lower() not in RAW:
        return measures(force_meant(said), "N")
    words = set(words_of(table.header[index]))
    return bool(words & _SURE_FORCES) and not words & (_COUNTERS | _NO_FORCES - {*RAW})


def may_be_force(table: Table, index: int) -> bool:
    """Whether nothing says that a column is another quantity, or in another unit than of a force."""
    header = table.header[index]
    words = set(words_of(header))
    if words & {"index", "sample", "trial", "row", "unnamed"} or _names_another(header):
        return False
    if words & _NO_FORCES - {*RAW} and not words & FORCES:
        return False
    said = said_unit(table, index)
    return said is None or said.lower() in RAW or measures(force_meant(said), "N")


def _names_another(header: str) -> bool:
    """Whether a header is that of a quantity but a tension, or of one of several tendons."""
    own, dot, _ = header.partition(".")
    for quantity, column in COLUMNS.items():
        name = split_unit(own, column.unit)[0]
        if plain_name(name) in column.spellings and name != "T":
            return bool(dot) or quantity not in NEEDED
    return False


def said_unit(table: Table, index: int) -> str | None:
    """The unit that a header, by brackets or its ending, or a row of units says; None if neither does."""
    units = (split_unit(table.header[index], si)[1] for si in ("N", "m", "s", "rad"))
    said = next((unit for unit in units if unit is not None), None) or table.unit(index)
    return said.strip() if said else None


def _is_another(table: Table, index: int, *, sided: bool) -> bool:
    """Whether the unit of a column says that it is not a force, or, unless its header names an end of the
    tendon (`sided`), its numbers that it is a clock.
    """
    said = said_unit(table, index)
    if said is not None and not measures(force_meant(said), "N"):
        return any(measures(said, si) for si in DIMENSIONS if si != "N")
    try:
        return not (sided or says_force(table, index)) and is_clock(table.column(index, most_absent=1.0))
    except InputError:
        return False


def meant_column(
    table: Table, quantity: str, tendon: str, tendons: Sequence[str], *, taken: Collection[int] = ()
) -> int | None:
    """The column that may be a quantity under a name that is not known, and is not taken; None if none
    suggests itself.
    """
    spellings = {s: q for q, column in COLUMNS.items() for s in column.spellings}
    si = column_of(quantity).unit
    others = [other for other in tendons if other != tendon]
    sides = {word: q for q, words in _SIDES.items() for word in words}
    scores: dict[int, float] = {}
    for index, header in enumerate(table.header):
        own = of_tendon(header, tendon) or header
        name = plain_name(split_unit(own, si)[0])
        if not header or any(of_tendon(header, other) for other in others) or not table.has_numbers(index):
            continue
        if index in taken:
            continue
        if spellings.get(name, quantity) != quantity:
            continue  # it is another quantity
        words = words_of(header)
        score = 1.0 if quantity in NEEDED and FORCES.intersection(words) else 0.0
        for word, side in sides.items():
            if quantity in NEEDED and any(w.startswith(word) or w.endswith(word) for w in words):
                score += 2.0 if side == quantity else -9.0
        score -= 9.0 * len(_NO_FORCES.intersection(words)) * (quantity in NEEDED)
        alike = [difflib.SequenceMatcher(None, name, s).ratio() for s in column_of(quantity).spellings]
        score += 3.0 * max(alike) if max(alike) > _ALIKE else 0.0
        if score > 0 and not (quantity in NEEDED and _is_another(table, index, sided=score > 1)):
            scores[index] = score
    best = [index for index, score in scores.items() if score == max(scores.values())]
    return best[0] if len(best) == 1 else None


def unread(table: Table, index: int, key: str) -> str:
    """A sentence on a column that is not read, though it may be the one that is missing."""
    header = table.header[index]
    entry = f"{key}={header}[{unit_meant(table, index, column_of(key.partition('.')[0]).unit)}]"
    return f"has no {key}; if that is column '{header}', add --columns '{entry}'"


def unit_remedy(table: Table, key: str, index: int, si: str) -> str:
    """What to add to the command for a column whose unit is not understood."""
    return f"give its unit with --columns '{key}={table.header[index]}[{unit_meant(table, index, si)}]'"


def unit_meant(table: Table, index: int, si: str) -> str:
    """The unit that a column is likely to be in: as its header or a row of units has it, for tensions with
    the force for the mass; grams-force where newtons would be many.
    """
    header = table.header[index]
    ending = re.split(r"[\s_]+", header)[-1]
    for said in (split_unit(header, si)[1], table.unit(index), ending):
        word = "" if said is None else said.strip("[]() ")
        word = force_meant(word) if si == "N" else word
        if measures(word, si):
            return word
    try:
        large = si == "N" and float(np.max(np.abs(table.column(index)))) > RARE_NEWTONS
    except InputError:
        large = False
    return "gf" if large else si
