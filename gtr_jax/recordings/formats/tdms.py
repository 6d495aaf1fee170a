"""Files of LabVIEW and other programs of NI (.tdms), read by nptdms."""

from __future__ import annotations

import io
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gtr_jax.errors import InputError, listed

from .cells import NumberCells
from .expansion import check_numbers
from .quantities import SPELLINGS, plain_name
from .sheet import Table
from .subprocess_reader import read_in_subprocess
from .time_stamps import SECOND

MAGIC, ENDINGS = b"TDSm", (".tdms",)
_WORDS = ("unit_string", "NI_UnitDescription")
_Clock = tuple[float, float, str]


class _Channel(NamedTuple):
    """A channel: its names, its numbers, (K,), its unit, and its first sample, interval [s] and start."""

    group: str
    name: str
    values: np.ndarray
    unit: str
    clock: _Clock | None


def read_tdms(path: Path, data: bytes, sha256: str) -> Table:
    """The table of a TDMS file: its channels of numbers, scaled as the file says, under their names, or
    "group/channel" where two have one name, with the units that the file states. Channels of another length
    than most are left out. `time` is computed from the interval of the samples where the file states one and
    no channel is of that name; stamps become seconds since the first.

    Raises InputError naming the file if it is damaged, holds more than a recording may, or no numbers.
    """
    channels = read_in_subprocess(
        channels_of, data, path=path, intact="a complete TDMS file", remedy="export it again"
    )
    found = [_Channel(*channel) for channel in channels]
    lengths = Counter(len(channel.values) for channel in found)
    if not lengths:
        raise InputError(f"{path}: no channel of this TDMS file holds numbers; at least one is needed")
    count = max(lengths, key=lambda length: (lengths[length], length))
    kept = [channel for channel in found if len(channel.values) == count]
    names = Counter(channel.name for channel in kept)
    header = [c.name if names[c.name] == 1 else f"{c.group}/{c.name}" for c in kept]
    units, columns = [c.unit for c in kept], [NumberCells(c.values) for c in kept]
    notes = []
    if len(kept) < len(found):
        others = listed(f"'{c.name}'" for c in found if len(c.values) != count)
        notes.append(f"{others} left out, of another length than most")
    clocks = {channel.clock for channel in kept}
    clock = next(iter(clocks)) if len(clocks) == 1 else None
    if clock is not None and not any(SPELLINGS.get(plain_name(name)) == "time" for name in header):
        header, units = ["time", *header], ["s", *units]
        columns = [NumberCells(clock[0] + clock[1] * np.arange(count)), *columns]
    return Table(
        path, sha256, header, columns, np.arange(1, count + 1), units, plain=True, notes=tuple(notes)
    )


def channels_of(data: bytes) -> list[tuple[Any, ...]]:
    """The channels of numbers and of stamps as `_Channel` has them.

    Raises InputError if they would have too many numbers.
    """
    from nptdms import TdmsFile

    found = []
    with TdmsFile.open(io.BytesIO(data)) as file:
        channels = [channel for group in file.groups() for channel in group.channels() if len(channel)]
        check_numbers(sum(map(len, channels)), f"has {len(channels)} channels of many samples")
        for channel in channels:
            values = channel[:]
            if values.dtype.kind == "M":
                stamps = values.astype("datetime64[ns]").astype(np.int64)
                values = (stamps - stamps[0]) / SECOND
                unit = "s"
            elif values.dtype.kind in "fiub":
                values = np.asarray(values, dtype=np.float64)
                unit = next(
                    (str(channel.properties[word]) for word in _WORDS if word in channel.properties), ""
                )
            else:
                continue
            found.append((channel.group_name, channel.name, values, unit.strip(), _clock(channel)))
    return found


def _clock(channel: Any) -> _Clock | None:
    """First sample and interval [s] of a channel, and when it begins; None where the file does not say."""
    said = channel.properties
    interval = float(said.get("wf_increment", 0.0))
    if not interval > 0:
        return None
    return float(said.get("wf_start_offset", 0.0)), interval, str(said.get("wf_start_time", ""))
