"""Running a sweep: block after block, in threads here or by workers elsewhere, from where it stopped."""

from __future__ import annotations

import dataclasses
import functools
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .config import SweepConfig, load_sweep
from .lanes import Lanes
from .plan import draw
from .store import Store, open_sweep
from .task import Task, task_of

if TYPE_CHECKING:
    import xarray

AHEAD = 2  # blocks queued for each thread


@dataclasses.dataclass(frozen=True)
class Done:
    """What a run has computed.

    Attributes:
        points: in this run.
        seconds: that they took, without compiling.
        compiling: seconds until the program was compiled; None where workers did it.
        lost: blocks that failed, with the error message.
    """

    points: int
    seconds: float
    compiling: float | None = None
    lost: tuple[tuple[int, str], ...] = ()

    @property
    def rate(self) -> float:
        """Points per second."""
        return self.points / self.seconds if self.seconds > 0 else float("nan")


Report = Callable[[str], None]


def run_here(task: Task, store: Store, blocks: Sequence[int], progress: Report, threads: int = 0) -> Done:
    """Compute blocks of a sweep in threads of this process.

    Args:
        task, store: the sweep.
        blocks: which.
        progress: is told what goes on.
        threads: how many; as many as cores unless given.
    """
    if not blocks:
        return Done(0, 0.0)
    progress("compiling")
    began = time.monotonic()
    lanes = Lanes(task)
    compiled = time.monotonic()

    count = threads_of(threads)
    done = 0
    meter = Meter(task, blocks, progress)
    with ThreadPoolExecutor(count) as pool:
        try:
            submit = functools.partial(pool.submit, solve_block, store, lanes)
            for finished in in_turn(blocks, submit, _first_done, count * (1 + AHEAD)):
                done += finished.result()
                meter(done)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return Done(done, time.monotonic() - compiled, compiled - began)


def solve_block(store: Store, lanes: Lanes, block: int) -> int:
    """Compute and store one block; the number of its points."""
    points = store.points(block)
    store.write(block, lanes.solve(points))
    return len(points)


def _first_done(pending: set[Future]) -> set[Future]:
    return set(wait(pending, return_when=FIRST_COMPLETED).done)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads_of(wanted: int) -> int:
    """Threads to solve a sweep in: as many as wanted, or one per core; one on an accelerator, which is busy
    with one batch.
    """
    import jax

    return 1 if jax.default_backend() != "cpu" else wanted or cores()


def in_turn(blocks: Iterable[int], submit, first_done, ahead: int) -> Iterator:
    """Futures of blocks as they finish; at most `ahead` of them are queued or running at a time."""
    left, pending = iter(blocks), set()
    while True:
        for block in left:
            pending.add(submit(block))
            if len(pending) >= ahead:
                break
        if not pending:
            return
        finished = first_done(pending)
        pending -= finished
        yield from finished


class Meter:
    """Reports how much is done, how fast, and how long the rest takes.

    Args:
        task, blocks: the sweep, and which blocks of it are computed.
        progress: is told.
        unsettled: number of blocks that are not timed: each worker's first, before which it compiles.
    """

    def __init__(self, task: Task, blocks: Sequence[int], progress: Report, unsettled: int = 0) -> None:
        self.total = len(blocks) * task.plan.points / max(task.plan.blocks, 1)
        self.progress = progress
        self.unsettled = unsettled
        self.began, self.before = time.monotonic(), 0
        self.calls = -1
        self(0)

    def __call__(self, done: int) -> None:
        self.calls += 1
        if self.calls <= self.unsettled:
            self.began, self.before = time.monotonic(), done
        passed, new = time.monotonic() - self.began, done - self.before
        says = f"{done:,} of {self.total:,.0f} points"
        if new > 0 and passed > 0:
            left = max(self.total - done, 0.0) * passed / new
            says += f", {new / passed:,.0f} per second, {duration(left)} left"
        self.progress(says)


def duration(seconds: float) -> str:
    """A duration in readable form."""
    if seconds < 1:
        return "less than 1 s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"


@dataclasses.dataclass(frozen=True)
class Estimate:
    """What a sweep will take.

    Attributes:
        points, blocks: of the sweep.
        bytes: size of its outputs before compression.
        seconds: for its points on this machine, without compiling.
        compiling: seconds for compiling.
    """

    points: int
    blocks: int
    bytes: int
    seconds: float
    compiling: float


def estimate(task: Task, threads: int = 0) -> Estimate:
    """Compile the program and time it on the first block of a sweep, in every thread, writing nothing."""
    count = threads_of(threads)
    began = time.monotonic()
    lanes = Lanes(task)
    compiling = time.monotonic() - began
    plan, points = task.plan, _first_points(task)
    lanes.solve(points)
    began = time.monotonic()
    with ThreadPoolExecutor(count) as pool:
        list(pool.map(lanes.solve, [points] * count))
    rounds = -(-plan.blocks // count)
    took = (time.monotonic() - began) * rounds
    return Estimate(plan.points, plan.blocks, plan.points * task.bytes_each, took, compiling)


def _first_points(task: Task) -> np.ndarray:
    if task.plan.gridded:
        return task.plan.on_grid(0)
    drawn = task.table if task.table is not None else next(iter(draw(task.file, task.axes)))
    return drawn[: task.plan.largest]


def sweep(
    file: SweepConfig | str | Path,
    store: str | Path,
    *,
    threads: int = 0,
    progress: Report = lambda says: None,
) -> xarray.Dataset:
    """Compute a sweep into a Zarr store, or resume one that was interrupted.

    Args:
        file: a sweep file, or its path.
        store: folder of the Zarr store to write.
        threads: of this process; as many as cores unless given.
        progress: is told what goes on.

    Returns:
        The dataset, as `open_sweep` gives it.

    Raises:
        InputError: the file is wrong, or the store holds another sweep.
    """
    task = task_of(file if isinstance(file, SweepConfig) else load_sweep(file))
    there = Store(Path(store), task)
    there.create()
    run_here(task, there, there.left(), progress, threads)
    there.clean()
    return open_sweep(there.path)
