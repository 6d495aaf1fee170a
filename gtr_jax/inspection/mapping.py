"""Which column was taken for which quantity, in which unit and why, for the reader to confirm."""

from __future__ import annotations

import dataclasses

import numpy as np

from gtr_jax.errors import InputError, listed
from gtr_jax.numbers import number
from gtr_jax.recordings.columns import Columns, mapped
from gtr_jax.recordings.formats.quantities import COLUMNS, NEEDED, quantities_of, split_unit
from gtr_jax.recordings.formats.table import Table
from gtr_jax.recordings.guessing import Guess, Guessed
from gtr_jax.units import convert, measures

FORCES = ("N", "gf", "mN")
"""Units of force in which cells are read out."""
PEAK = 99.5  # percentile of the readings, which glitches do not move


@dataclasses.dataclass(frozen=True)
class Taken:
    """A column that was taken for a quantity.

    Attributes:
        quantity, header, unit: which, and in which unit; None of time stamps.
        why: why, as a sentence without its end.
        sure: whether the file or the user says so.
        named: the header, with the factor and the offset by which its numbers are converted, if any.
    """

    quantity: str
    header: str
    unit: str | None
    why: str
    sure: bool
    named: str = ""

    @property
    def source(self) -> str:
        """The right side of a mapping: the header, with the unit in brackets where it must be said."""
        si, named = COLUMNS[self.quantity].unit, self.named or self.header
        if self.unit is None or split_unit(self.header, si)[1] == self.unit:
            return named
        return f"{named} [{self.unit}]"


@dataclasses.dataclass(frozen=True)
class Mapping:
    """The columns of a recording.

    Attributes:
        taken: what was taken for what.
        doubts: what the reader should confirm, a sentence each; empty if all is sure.
        unused: headers of the other columns.
    """

    taken: tuple[Taken, ...]
    doubts: tuple[str, ...]
    unused: tuple[str, ...]

    @property
    def columns(self) -> dict[str, str]:
        """The mapping as a mapping file has it."""
        return {t.quantity: t.source for t in self.taken}


def mapping(table: Table, guessed: Guess, said: Columns | None) -> Mapping:
    """The columns, as the user says where he does and as guessed elsewhere.

    Args:
        table: the file.
        guessed: from `guess`.
        said: what the user says, or None.

    Raises:
        InputError: the user names a quantity or a column that there is none of, or the file holds volts or
            counts in place of forces.
    """
    own = {} if said is None else mapped(table, said, quantities_of(()), ())
    taken = {
        quantity: Taken(
            quantity,
            table.header[source.index],
            source.unit
            or table.unit(source.index)
            or (COLUMNS[quantity].unit if table.has_numbers(source.index) else None),
            "as --columns says",
            True,
            source.named(table.header[source.index]),
        )
        for quantity, source in own.items()
    }
    used = {source.index for source in own.values()}
    for quantity, g in guessed.quantities.items():
        # Where the user maps anything, only headers that name their quantity count beside it.
        if quantity not in taken and g.index not in used and (said is None or g.found == "header"):
            if quantity in NEEDED and g.unit is not None and not measures(g.unit, COLUMNS[quantity].unit):
                raise InputError(f"{table.path}: {'; '.join(g.notes) or g.says}")
            taken[quantity] = Taken(quantity, g.header, g.unit, _why(g), g.sure or _plainly(g))
    ordered = tuple(taken[q] for q in COLUMNS if q in taken)
    headers = {t.header for t in ordered}
    unused = tuple(header for header in table.header if header and header not in headers)
    return Mapping(ordered, tuple(_doubts(table, ordered, unused)), unused)


def _why(g: Guessed) -> str:
    """The reasons of a guess, without what it is of."""
    return g.says.removeprefix(f"{g.quantity} = '{g.header}' (").replace(")", "", 1)


def _plainly(g: Guessed) -> bool:
    """Whether a header names its quantity in a file that is in SI because it says nothing else: as every
    recording without units is read.
    """
    return g.found == "header" and g.unit_found == "nothing" and not g.notes


def _newtons(value: float, unit: str) -> str:
    return number(convert(value, unit, "N"), "N", 3)


def _doubts(table: Table, taken: tuple[Taken, ...], unused: tuple[str, ...]) -> list[str]:
    """What to confirm."""
    doubts = []
    for t in taken:
        if t.sure:
            continue
        doubt = f"{t.quantity} is guessed to be column '{t.header}'" + (f" in {t.unit}" if t.unit else "")
        doubt += f" ({t.why})"
        if t.quantity in NEEDED and t.unit in FORCES:
            values = table.column(table.header.index(t.header), 1.0)
            peak = float(np.nanpercentile(np.abs(values), PEAK))
            sizes = [f"{_newtons(peak, unit)} in {unit}" for unit in FORCES if unit != t.unit]
            doubt += f": its peak is then {_newtons(peak, t.unit)}, and would be {' and '.join(sizes)}"
        doubts.append(doubt + ".")
    if doubts and unused:
        doubts.append(f"Unused columns: {listed(unused)}.")
    return doubts
