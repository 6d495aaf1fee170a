"""Simulations done before, kept in a file: a diagnosis that was interrupted goes on where it stopped.

A diagnosis does the same simulations in the same order whenever it is run on the same input, so those that a
file holds need not be done again, and the answer is that of an uninterrupted run to the last bit.
"""

from __future__ import annotations

import contextlib
import sqlite3
import threading
import time
from pathlib import Path

import numpy as np

EVERY_S = 0.5


class Memory:
    """A file of arrays by key; threads may share it. One that cannot be read or written is done without.

    Args:
        path: of the file; made if there is none.
    """

    def __init__(self, path: Path):
        self.path, self._lock, self._written = path, threading.Lock(), time.monotonic()
        self._file: sqlite3.Connection | None = None
        for fresh in (False, True):
            try:
                if fresh:
                    path.unlink(missing_ok=True)
                path.parent.mkdir(parents=True, exist_ok=True)
                self._file = sqlite3.connect(path, check_same_thread=False, timeout=2.0)
                # The system keeps what a killed process has written; a power cut may cost the file.
                self._file.execute("PRAGMA synchronous = OFF")
                self._file.execute("CREATE TABLE IF NOT EXISTS done (key BLOB PRIMARY KEY, value BLOB)")
                break
            except (sqlite3.Error, OSError):
                self._file = None

    def __len__(self) -> int:
        if self._file is None:
            return 0
        with self._lock, contextlib.suppress(sqlite3.Error):
            return int(self._file.execute("SELECT COUNT(*) FROM done").fetchone()[0])
        return 0

    def get(self, key: bytes) -> np.ndarray | None:
        """What was put under a key, flat; None if nothing was."""
        if self._file is None:
            return None
        with self._lock, contextlib.suppress(sqlite3.Error):
            row = self._file.execute("SELECT value FROM done WHERE key = ?", (key,)).fetchone()
            return None if row is None else np.frombuffer(row[0])
        return None

    def put(self, key: bytes, value: np.ndarray) -> None:
        """Keep an array of float64."""
        if self._file is None:
            return
        with self._lock, contextlib.suppress(sqlite3.Error):
            self._file.execute("INSERT OR REPLACE INTO done VALUES (?, ?)", (key, value.tobytes()))
            if time.monotonic() - self._written > EVERY_S:
                self._file.commit()
                self._written = time.monotonic()

    def close(self) -> None:
        """Write what is not yet written."""
        if self._file is not None:
            with self._lock, contextlib.suppress(sqlite3.Error):
                self._file.commit()
                self._file.close()
            self._file = None

    def forget(self) -> None:
        """Close and take the file away."""
        self.close()
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)
