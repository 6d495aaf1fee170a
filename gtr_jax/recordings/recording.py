"""Recordings: tendon tensions at the base and the tip over time, read and written in SI units.

A header row, then rows in time order; the order of the rows is the load history. Every fault is reported
with the row number that an editor shows. What a file may look like is in `table`; what is left out of it in
`masking`.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtr_jax.atomic_write import write_atomically
from gtr_jax.errors import InputError

from .cleaning.masking import Masked, masks
from .columns import Columns, Source, mapped, read_columns
from .formats.csv_writing import csv_of
from .formats.headers import meant_column, missing, recognised, unit_remedy, unread
from .formats.quantities import (
    COLUMNS,
    DRIVES,
    NEEDED,
    PER_TENDON,
    QUATERNION,
    column_of,
    marker_quantities,
    quantities_of,
    with_tendon,
)
from .formats.table import Table, read_table
from .guessing import Guess as Guess
from .guessing import Guessed as Guessed
from .guessing import guess as guess
from .headed import dataset_of, frame_of, headed

if TYPE_CHECKING:
    import pandas
    import xarray

SWAP_FACTOR = 1.3
"""A tip tension peaking above this multiple of the base's suggests swapped columns or wrong units."""
QUATERNION_ERROR = 0.02
"""Most by which the length of a recorded quaternion may differ from 1."""
POSED = "record the pose of the tip (tip_x_m, ...) or markers of the robot file"
OTHERWISE = "record the pose of the tip (tip_x_m, ...), markers of the robot file, or displacement_m"
"""What a recording may be compared by in place of a tip tension: where displacement drives, and else."""
SAMPLE = "sample"
"""Dimension of recordings as tables and datasets."""
MOST_ABSENT = 0.05
"""Share of the cells of a column that may be without a number; their rows are left out."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording in SI units: read-only float64 arrays, one value per row; None where not recorded.

    T_base and T_tip [N], time [s], tip_x, tip_y and tip_z [m], tip_angle [rad] against the base tangent,
    tip_qx to tip_qw, the unit quaternion of the tip, displacement [m] of the tendon pulled out at the base,
    and the number of the trial. Of several tendons, named in `tendons`, T_base, T_tip and displacement are
    (rows, tendons); T_base and displacement of a tendon of which only the other is recorded are NaN.
    `markers` has the places of markers [m], by names such as "m1_x". `rows` are the numbers of the
    samples' rows in the file, `masked` is what was left out of it, `thinned_from` how many samples it had
    before it was thinned (0: it was not), and `notes` are sentences on how it was read.
    """

    T_base: np.ndarray
    path: Path
    sha256: str
    T_tip: np.ndarray | None = None
    time: np.ndarray | None = None
    tip_x: np.ndarray | None = None
    tip_y: np.ndarray | None = None
    tip_z: np.ndarray | None = None
    tip_angle: np.ndarray | None = None
    tip_qx: np.ndarray | None = None
    tip_qy: np.ndarray | None = None
    tip_qz: np.ndarray | None = None
    tip_qw: np.ndarray | None = None
    displacement: np.ndarray | None = None
    trial: np.ndarray | None = None
    tendons: tuple[str, ...] = ()
    rows: np.ndarray | None = None
    masked: tuple[Masked, ...] = ()
    thinned_from: int = 0
    notes: tuple[str, ...] = ()
    markers: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.T_base)

    def to_pandas(self) -> pandas.DataFrame:
        """The recording as a table, its columns as `write_recording` writes them: SI, units in the names."""
        return frame_of(columns_of(self), SAMPLE)

    def to_xarray(self) -> xarray.Dataset:
        """The recording as a dataset: (sample,), of several tendons (sample, tendon), SI with `units`."""
        return dataset_of(columns_of(self), SAMPLE, tendons=self.tendons)

    @property
    def quantities(self) -> set[str]:
        """Names of the quantities that were recorded, those of markers too."""
        there = {name for name in COLUMNS if getattr(self, name) is not None}
        nothing = {name for name in there & {*DRIVES} if np.all(np.isnan(getattr(self, name)))}
        return (there - nothing) | {*self.markers}

    @property
    def tip_quaternion(self) -> np.ndarray | None:
        """The unit quaternion of the tip (x, y, z, w), (rows, 4); None where not recorded."""
        parts = [getattr(self, name) for name in QUATERNION]
        return None if parts[0] is None else np.stack(parts, axis=1)


def read_recording(
    path: str | os.PathLike[str] | Table,
    columns: str | os.PathLike[str] | Columns | None = None,
    *,
    need_tip: bool = True,
    measured: bool = False,
    tendons: Sequence[str] = (),
    keep_glitches: bool = False,
    drop: Sequence[str] = (),
    doubtful: bool = False,
    markers: Sequence[str] = (),
    space: bool = False,
) -> Recording:
    """Read a recording (or a base-tension history) from a file.

    Args:
        path: the file, or the table read from it; its header names the quantities and their units (COLUMNS),
            SI where none is given.
        columns: columns under other names, as 'T_base=data_0[gf],T_tip=data_2[gf],time=Time[s]', converted
            as 'T_base=raw_0*0.00981-1.2[N]', or the path of a mapping file, or either as read (see
            `columns`). It may also ask for what the last arguments do; the quantities it leaves out are still
            looked for in the header. Columns of no use are ignored.
        need_tip: whether a file without a tip tension is refused.
        measured: whether one without a tip tension is a recording nonetheless, of the tip's pose, markers or
            displacements: then one is refused only that has none of these either, and where it has times,
            glitches are looked for. Without times, rows may be holds that have nothing to do with their
            neighbours.
        tendons: names of the tendons, if the robot has several: then T_base, T_tip and displacement are
            looked for as T_base_N.left and the like, for all of them or none, and are (rows, tendons).
        keep_glitches: whether glitches and dropouts are kept (see `glitches`). They are never looked for in
            a history without a tip tension, which prescribes loads and measures none, unless it is
            `measured`.
        drop: stretches of time to leave out, as "12.5 s:13 s", "12.5:13" [s], or ":2 s" for the beginning.
        doubtful: whether time going backwards and a tip tension far above the base's are let pass, for
            somebody who looks for what is wrong with a recording.
        markers: names of the robot's markers, whose places are looked for.
        space: whether the robot may leave its plane, or be driven by displacement: then tip_z and the tip's
            orientation are looked for, and the displacement of a tendon may stand for its base tension.

    What is left out is in `masked`: glitches, dropped stretches, and rows in which a cell is empty or NaN, as
    long as these are no more than MOST_ABSENT of a column.

    Raises InputError naming file, row, column and remedy: see `read_table`; missing or doubtful columns,
    unknown units, cells that are not a number, stretches that cannot be read or hold no sample, and, in what
    is left: time going backwards, tensions of reversed sign, and a tip tension that peaks more than
    SWAP_FACTOR above the base's. Small negative readings are noise and kept.
    """
    table = path if isinstance(path, Table) else read_table(path)
    said = None if columns is None else read_columns(columns, f"{table.path}: ")
    wanted = quantities_of(tendons, markers=markers, space=space)
    chosen = {} if said is None else mapped(table, said, wanted, tendons)
    taken = {source.index for source in chosen.values()}
    for key, (quantity, tendon) in wanted.items():
        found = None if key in chosen else recognised(table, quantity, tendon)
        if found and found[0] not in taken:
            chosen[key] = Source(*found)
    begun = {wanted[key][0] for key in chosen}
    compared = _compared(begun)
    needed = NEEDED if need_tip and not (measured and compared) else NEEDED[:1]
    absent = [
        key
        for key, (quantity, tendon) in wanted.items()
        if key not in chosen
        and (quantity in needed or (tendon and quantity in begun))
        and not (space and quantity in DRIVES and _drive_of(tendon, chosen))
    ]
    if set(QUATERNION) & begun:
        absent += [key for key in QUATERNION if key not in chosen]
    if absent:
        guessed = guess(table, tendons).quantities
        mapping = {key: g.source.replace(" [", "[") for key, g in guessed.items() if key not in chosen}
        fault = missing(table, absent, wanted, tendons, guessed=mapping)
        if not measured or wanted[absent[0]][0] != "T_tip" or "T_tip" in begun:  # of some tendons, it has
            raise fault
        raise InputError(f"{fault}; or {OTHERWISE if 'T_base' in begun else POSED}")
    notes = (*table.notes, "has no header: its columns are numbered") if table.numbered else table.notes
    if measured and "T_tip" not in begun:
        first = next(key for key, (quantity, _) in wanted.items() if quantity == "T_tip")
        meant = meant_column(table, *wanted[first], tendons, taken={own.index for own in chosen.values()})
        if meant is not None:
            notes = (*notes, unread(table, meant, first))
    whole = {}
    for key, (quantity, _) in wanted.items():
        if key in chosen:
            index, unit, scale, offset = chosen[key]
            si = column_of(quantity).unit
            remedy = functools.partial(unit_remedy, table, key, index, si)
            whole[key] = table.quantity(
                index, unit, si, remedy=remedy, most_absent=MOST_ABSENT, scale=scale, offset=offset
            )
    units = {key: column_of(wanted[key][0]).unit for key in whole}
    glitches = (
        seeks_glitches(begun, measured=measured) and not keep_glitches and not (said and said.keep_glitches)
    )
    stretches = [*(said.drop if said else ()), *drop]
    try:
        keep, masked = masks(whole, units, table.numbers, glitches=glitches, drop=stretches)
    except InputError as fault:
        raise InputError(f"{table.path}: {fault}") from None
    if not keep.any():
        raise InputError(f"{table.path}: no sample is left; drop less of it")
    data = {key: values[keep] for key, values in whole.items()}
    data |= _unit_quaternion(table.path, np.asarray(table.numbers)[keep], data)
    rows = np.asarray(table.numbers)[keep]
    for values in (*data.values(), rows):
        values.setflags(write=False)
    headers = {key: table.header[source.index] for key, source in chosen.items()}
    for name in tendons or ("",):
        own = [key for key, (_, tendon) in wanted.items() if key in data and tendon in ("", name)]
        signals = {wanted[key][0]: data[key] for key in own}
        named = {wanted[key][0]: headers[key] for key in own}
        _check_signals(table.path, rows, signals, named, alone=not tendons, doubtful=doubtful)
    placed = {key for name in markers for key in marker_quantities(name) if key in data}
    by_quantity = _by_quantity({key: data[key] for key in data if key not in placed}, tendons)
    if "T_base" not in by_quantity:
        by_quantity["T_base"] = np.full_like(by_quantity["displacement"], np.nan)
        by_quantity["T_base"].setflags(write=False)
    return Recording(
        **by_quantity,
        markers={key: data[key] for key in data if key in placed},
        path=table.path,
        sha256=table.sha256,
        tendons=tuple(tendons),
        rows=rows,
        masked=masked,
        notes=notes,
    )


def seeks_glitches(quantities: Set[str], *, measured: bool) -> bool:
    """Whether glitches are looked for in a file of these quantities: not where it prescribes loads and
    measures nothing, nor without times, where rows may be holds.

    Args:
        quantities: by name.
        measured: as of `read_recording`.
    """
    return "T_tip" in quantities or (measured and bool(_compared(quantities)) and "time" in quantities)


def _compared(quantities: Set[str]) -> set[str]:
    """Those of the quantities that a simulation can be compared with."""
    return {*quantities} - {"time", "trial", *(DRIVES if "T_base" not in quantities else DRIVES[:1])}


def _drive_of(tendon: str, chosen: Iterable[str]) -> bool:
    """Whether a column says how a tendon is driven."""
    return any(with_tendon(quantity, tendon) in chosen for quantity in DRIVES)


def _by_quantity(data: Mapping[str, np.ndarray], tendons: Sequence[str]) -> dict[str, Any]:
    """Columns by quantity; those of several tendons side by side, NaN where a tendon has none."""
    out = {key: values for key, values in data.items() if "." not in key}
    absent = np.full(len(next(iter(data.values()))), np.nan)
    for quantity in PER_TENDON if tendons else ():
        columns = [data.get(f"{quantity}.{name}", absent) for name in tendons]
        if any(column is not absent for column in columns):
            out[quantity] = np.stack(columns, axis=1)
            out[quantity].setflags(write=False)
    return out


def _unit_quaternion(path: Path, rows: np.ndarray, data: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The columns of the tip's orientation, scaled to length one; InputError if they are not a rotation."""
    if QUATERNION[0] not in data:
        return {}
    size = np.linalg.norm([data[name] for name in QUATERNION], axis=0)
    off = np.abs(size - 1.0)
    worst = int(np.argmax(off))
    if off[worst] > QUATERNION_ERROR:
        raise InputError(
            f"{path}: row {rows[worst]}, columns {', '.join(QUATERNION)}: a quaternion of length "
            f"{size[worst]:.4g} is not a rotation; its length must be 1"
        )
    return {name: data[name] / size for name in QUATERNION}


def _check_signals(
    path: Path,
    rows: np.ndarray,
    data: Mapping[str, np.ndarray],
    headers: Mapping[str, str],
    *,
    alone: bool,
    doubtful: bool,
) -> None:
    """Refuse what no recording of a pulled tendon shows: backward time, pushing tendons, and, unless others
    may drag it, swapped cells.
    """
    if "time" in data and not doubtful:
        backwards = np.flatnonzero(np.diff(data["time"]) < 0)
        if backwards.size:
            i = backwards[0]
            raise InputError(
                f"{path}: row {rows[i + 1]}, column '{headers['time']}': "
                f"time goes backwards, from {data['time'][i]:.6g} s to {data['time'][i + 1]:.6g} s; "
                "put the rows in time order, or give each trial its own file"
            )
    base_peak = float(np.max(data["T_base"])) if "T_base" in data else math.inf
    for quantity in ("T_base", "T_tip"):
        if quantity not in data:
            continue
        row = int(np.argmin(data[quantity]))
        lowest, highest = float(data[quantity][row]), float(np.max(data[quantity]))
        # A tip cell that hardly sees tension may dwell below zero; a reversed one mirrors the pull.
        if lowest < 0 and -lowest > max(highest, 0.1 * base_peak if quantity == "T_tip" else 0.0):
            raise InputError(
                f"{path}: row {rows[row]}, column '{headers[quantity]}': {quantity} peaks at "
                f"{lowest:.4g} N, but a tendon only pulls; reverse the sign of the column, as --columns "
                f"'{quantity}={headers[quantity]}*-1[UNIT]' does, or map another"
            )
    if alone and not doubtful and "T_tip" in data:
        row = int(np.argmax(data["T_tip"]))
        tip_peak = float(data["T_tip"][row])
        if tip_peak > SWAP_FACTOR * base_peak:
            raise InputError(
                f"{path}: row {rows[row]}, column '{headers['T_tip']}': "
                f"T_tip peaks at {tip_peak:.4g} N and T_base at {base_peak:.4g} N; "
                "columns swapped or units mixed? check --columns 'T_base=NAME[unit],T_tip=NAME[unit]'"
            )


def columns_of(recording: Recording) -> dict[str, np.ndarray]:
    """The columns of a recording by their headers, (rows,) each."""
    given = {own.name: getattr(recording, own.name) for own in fields(recording)}
    named = {quantity: given[quantity] for quantity in COLUMNS} | dict(recording.markers)
    return headed(named, tendons=recording.tendons, markers=recording.markers)


def write_recording(
    path: str | os.PathLike[str],
    recording: Recording | Mapping[str, Iterable[float] | Sequence[str]],
    *,
    tendons: Sequence[str] = (),
) -> None:
    """Write a recording, or columns by name, as a CSV file that `read_recording` reads back exactly.

    The quantities of COLUMNS (SI) come first, under their headers with units; further columns follow under
    the names they are given, which should carry their unit. None is left out, and so is a tendon's column of
    NaN. A quantity of several tendons, (rows, tendons), becomes a column for each of `tendons`, ending with
    its name. The file is written whole or not at all.

    Raises ValueError if the columns differ in length.
    """
    if isinstance(recording, Recording):
        columns = columns_of(recording)
    else:
        columns = headed(recording, tendons=tendons)
    write_atomically(path, csv_of(columns))
