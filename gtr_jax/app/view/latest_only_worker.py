"""Work in a thread of its own, always on the latest request: those overtaken meanwhile are left out."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Request = TypeVar("Request")


class LatestOnlyWorker(Generic[Request]):
    """A thread that does one thing for the latest request, whenever there is a new one.

    Args:
        work: called in the thread with a request; must not raise.
    """

    def __init__(self, work: Callable[[Request], None]) -> None:
        self._work = work
        self._there = threading.Condition()
        self._wanted: list[Request] = []
        self._over = False
        self._thread = threading.Thread(target=self._serve, name="live page", daemon=True)
        self._thread.start()

    def ask(self, request: Request) -> None:
        """Ask for this next, in place of a request that has not been begun."""
        with self._there:
            self._wanted = [request]
            self._there.notify()

    def close(self) -> None:
        """End the thread, after what it is at, without waiting for it."""
        with self._there:
            self._over = True
            self._there.notify()

    def wait(self) -> None:
        """Wait until the thread has ended."""
        self._thread.join()

    def _serve(self) -> None:
        while True:
            with self._there:
                self._there.wait_for(lambda: self._wanted or self._over)
                if self._over:
                    return
                request = self._wanted.pop()
            self._work(request)
