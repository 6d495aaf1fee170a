"""Recordings of ROS: bags of ROS 1 and ROS 2 (.bag, .mcap, .db3, or a bag's folder), read by rosbags.

Every number in the messages of a topic is a column "/topic.field". The rows are the messages of one topic:
of those whose names speak of forces, or else of all, the one with most messages; `time` is when they were
recorded. Other topics are joined by the last value that was received before.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gtr_jax.errors import InputError, listed

from .cells import NumberCells
from .expansion import check_numbers
from .headers import FORCES, words_of
from .sheet import Table
from .subprocess_reader import read_in_subprocess
from .time_stamps import SECOND

ENDINGS = (".bag", ".mcap", ".db3")
MAGICS = (b"#ROSBAG V", b"\x89MCAP0\r\n", b"SQLite format 3\x00")
_LONGEST = 64  # numbers of an array that become columns
_DEEPEST = 6  # messages in messages
_SPEAK = FORCES | {"wrench", "wrenches", "forces", "tensions", "cells", "loadcells", "base", "tip"}


class _Topic(NamedTuple):
    """Numbers of a topic's messages: their stamps [ns], (K,), and the fields' values, (K,) each."""

    stamps: np.ndarray
    fields: dict[str, np.ndarray]


def read_bag(path: Path, sha256: str) -> Table:
    """The table of a ROS recording.

    Raises InputError naming the file if it is damaged, holds no numbers, or rosbags is not installed.
    """
    if not _installed():
        raise InputError(
            f"{path}: a recording of ROS; pip install 'gtr-jax[ros]', or export its topics as CSV"
        )
    topics = read_in_subprocess(
        topics_of, str(path.absolute()), path=path, intact="a complete recording of ROS", remedy="reindex it"
    )
    if not topics:
        raise InputError(
            f"{path}: no topic of this recording holds numbers that can be read; export it as CSV"
        )
    first = max(topics, key=lambda name: (_speaks(name, topics[name]), len(topics[name].stamps)))
    stamps = topics[first].stamps
    header, columns = ["time"], [NumberCells((stamps - stamps[0]) / SECOND)]
    for name, topic in topics.items():
        last = np.searchsorted(topic.stamps, stamps, side="right") - 1
        for field, values in topic.fields.items():
            header.append(f"{name}.{field}")
            columns.append(NumberCells(values if name == first else np.where(last < 0, np.nan, values[last])))
    others = [name for name in topics if name != first]
    joined = f"; {listed(others)} joined by the last value received" if others else ""
    notes = (f"the rows are the messages of {first}{joined}",)
    return Table(path, sha256, header, columns, np.arange(1, len(stamps) + 1), plain=True, notes=notes)


def _speaks(name: str, topic: _Topic) -> bool:
    """Whether the names of a topic speak of forces."""
    words = {word for text in (name, *topic.fields) for word in words_of(text)}
    return bool(words & _SPEAK)


def _installed() -> bool:
    """Whether rosbags is."""
    return all(importlib.util.find_spec(name) is not None for name in ("rosbags", "rosbags.highlevel"))


def topics_of(path: str) -> dict[str, _Topic]:
    """The topics whose messages hold numbers, by name, in the order of their stamps.

    Raises InputError if these are too many.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    found: dict[str, tuple[list[int], list[list[float]], list[str]]] = {}
    count = 0
    with AnyReader([Path(path)], default_typestore=get_typestore(Stores.LATEST)) as reader:
        left_out: set[str] = set()
        for connection, stamp, raw in reader.messages():
            if connection.topic in left_out:
                continue
            try:
                message = reader.deserialize(raw, connection.msgtype)
            except Exception:
                left_out.add(connection.topic)  # of a type that the bag does not define
                continue
            numbers = dict(_numbers(message))
            if connection.topic not in found:
                if not numbers:
                    left_out.add(connection.topic)
                    continue
                found[connection.topic] = ([], [], list(numbers))
            stamps, rows, names = found[connection.topic]
            count += 1 + len(names)
            check_numbers(count, "its messages have too many numbers")
            stamps.append(stamp)
            rows.append([numbers.get(name, float("nan")) for name in names])
    topics = {}
    for topic, (stamps, rows, names) in sorted(found.items()):
        order = np.argsort(stamps, kind="stable")
        values = np.array(rows, dtype=float)[order]
        topics[topic] = _Topic(
            np.array(stamps, dtype=np.int64)[order], dict(zip(names, values.T, strict=True))
        )
    return topics


def _numbers(message: Any, before: str = "", depth: int = 0) -> Iterator[tuple[str, float]]:
    """The numbers of a message by the names of their fields; the stamps and frames of headers left out."""
    for name in message.__dataclass_fields__:
        value = getattr(message, name)
        if name in ("header", "layout") or name.startswith("__"):
            continue
        if isinstance(value, bool | int | float | np.number):
            yield f"{before}{name}", float(value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.size <= _LONGEST:
            for i, number in enumerate(value.ravel()):
                yield f"{before}{name}.{i}", float(number)
        elif hasattr(value, "__dataclass_fields__") and depth < _DEEPEST:
            yield from _numbers(value, f"{before}{name}.", depth + 1)
