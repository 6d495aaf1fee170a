"""Simulations side by side: those that several threads ask for go into the lanes of one program.

A search refits many models at once, each in a thread of its own, and each thread waits for its simulations.
Whoever waits takes what is asked for of one program, up to `LANES` at a time, and runs it for all: as many
programs at once as there are cores. What a simulation gives depends on nothing of those beside it, so an
answer does not depend on who met whom.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

from gtr_jax.simulation.natively import LANES, Brief, Native, ProgramSpec, Run

from .parallel import Item, Result, in_parallel, threads

# What simulations that go side by side share: robot, program and number of steps.
_Key = tuple[Native, ProgramSpec, int]


class _Asked:
    """A simulation that a thread waits for, and what came of it."""

    def __init__(self, key: _Key, run: Run):
        self.key, self.run = key, run
        self.found: Brief | None = None
        self.fault: Exception | None = None

    @property
    def done(self) -> bool:
        return self.found is not None or self.fault is not None


class _Counter:
    """Where threads ask for simulations and wait for them."""

    def __init__(self):
        self._change = threading.Condition()
        self._waiting: list[_Asked] = []
        self._running: set[int] = set()

    def __call__(self, native: Native, structure: ProgramSpec, runs: Sequence[Run]) -> list[Brief]:
        """Simulate; arguments as of `Native.side_by_side`, but any number of runs of any length."""
        own = [_Asked((native, structure, len(run.loads.time)), run) for run in runs]
        try:
            with self._change:
                self._waiting += own
                self._change.notify_all()
            while not all(asked.done for asked in own):
                self._serve(own)
        finally:
            with self._change:
                mine = {id(asked) for asked in own}
                self._waiting = [asked for asked in self._waiting if id(asked) not in mine]
        for asked in own:
            if asked.fault is not None:
                raise asked.fault
        return [asked.found for asked in own if asked.found is not None]

    def _serve(self, own: Sequence[_Asked]) -> None:
        """Simulate what was asked for first, once a core is free, unless `own` are done before. Where that is
        interrupted, it waits for another thread.
        """
        group: list[_Asked] = []
        try:
            with self._change:
                while not (self._waiting and len(self._running) < threads()):
                    if all(asked.done for asked in own):
                        return
                    self._change.wait()
                self._running.add(id(group))
                group += [asked for asked in self._waiting if asked.key == self._waiting[0].key][:LANES]
                taken = {id(asked) for asked in group}
                self._waiting = [asked for asked in self._waiting if id(asked) not in taken]
            _run(group)
        finally:
            with self._change:
                self._running.discard(id(group))
                left = {id(asked) for asked in self._waiting}
                back = [asked for asked in group if not asked.done and id(asked) not in left]
                self._waiting = back + self._waiting
                self._change.notify_all()


def _run(group: Sequence[_Asked]) -> None:
    """Simulate side by side; one by one where that fails, so that the fault is told to those who have it."""
    native, structure, _ = group[0].key
    try:
        briefs = native.side_by_side([asked.run for asked in group], structure)
    except Exception as fault:
        if len(group) == 1:
            group[0].fault = fault
            return
        for asked in group:
            _run([asked])
        return
    for asked, brief in zip(group, briefs, strict=True):
        asked.found = brief


simulated: Callable[[Native, ProgramSpec, Sequence[Run]], list[Brief]] = _Counter()


def in_lanes(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """work(item) for all items, in order, in so many threads that their simulations fill the lanes of the
    programs that run.
    """
    return in_parallel(work, items, LANES)
