"""Work shared among the processor's cores: compiled programs release the interpreter while they run."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


# Set by `use_threads`; None allows one thread for each core.
_most: int | None = None


def use_threads(most: int) -> None:
    """Use at most this many threads in this process, for processes that share the cores."""
    global _most
    _most = most


def threads() -> int:
    """How many threads are used: one for each core of this process, unless fewer were asked for."""
    try:
        available = len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        available = os.cpu_count() or 1
    return available if _most is None else min(_most, available)


def in_parallel(work: Callable[[Item], Result], items: Sequence[Item], each: int = 1) -> list[Result]:
    """work(item) for all items, in order, `each` threads for a core."""
    if len(items) < 2:
        return [work(item) for item in items]
    with ThreadPoolExecutor(threads() * each) as pool:
        return list(pool.map(work, items))
