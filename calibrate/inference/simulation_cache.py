"""Simulations done before, kept in a file: a diagnosis that was interrupted resumes where it stopped.

A diagnosis does the same simulations in the same order whenever it is run on the same input, so those that a
file holds need not be done again, and the answer is that of an uninterrupted run to the last bit.
"""

from __future__ import annotations

import contextlib
import sqlite3
import threading
from pathlib import Path

import numpy as np

# Wait for a file that another process has locked [s].
PATIENCE_S = 1.0


class SimulationCache:
    """A file of arrays by key; threads may share it. Where the file cannot be read or written, nothing is
    kept.

    Args:
        path: of the file; made when the first array is put.
    """

    def __init__(self, path: Path):
        self.path, self._lock = path, threading.Lock()
        self._file: sqlite3.Connection | None = None
        self._tried = False

    def _opened(self, *, make: bool) -> sqlite3.Connection | None:
        if self._file is not None or self._tried or not (make or self.path.exists()):
            return self._file
        self._tried = True
        for broken in (False, True):
            try:
                if broken:
                    self.path.unlink(missing_ok=True)
                self.path.parent.mkdir(parents=True, exist_ok=True)
                file = sqlite3.connect(
                    self.path, check_same_thread=False, timeout=PATIENCE_S, isolation_level=None
                )
                # The system keeps what a killed process has written; a power cut may cost the file.
                file.execute("PRAGMA synchronous = OFF")
                file.execute("CREATE TABLE IF NOT EXISTS done (key BLOB PRIMARY KEY, value BLOB)")
                self._file = file
                break
            except (sqlite3.Error, OSError):
                continue
        return self._file

    def __len__(self) -> int:
        with self._lock, contextlib.suppress(sqlite3.Error):
            file = self._opened(make=False)
            return 0 if file is None else int(file.execute("SELECT COUNT(*) FROM done").fetchone()[0])
        return 0

    def get(self, key: bytes) -> np.ndarray | None:
        """The array stored under a key, flattened; None if there is none."""
        with self._lock, contextlib.suppress(sqlite3.Error):
            file = self._opened(make=False)
            row = file and file.execute("SELECT value FROM done WHERE key = ?", (key,)).fetchone()
            return np.frombuffer(row[0]) if row else None
        return None

    def put(self, key: bytes, value: np.ndarray) -> None:
        """Store an array of float64."""
        with self._lock, contextlib.suppress(sqlite3.Error):
            file = self._opened(make=True)
            if file is not None:
                file.execute("INSERT OR REPLACE INTO done VALUES (?, ?)", (key, value.tobytes()))

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            if self._file is not None:
                with contextlib.suppress(sqlite3.Error):
                    self._file.close()
            self._file, self._tried = None, False
