"""Compiled programs on the disk: sealed, in one folder for all of the same origin."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from . import sealed

# How many folders with programs of earlier sources or settings are kept besides the current one.
EARLIER = 2


class Kept:
    """Where programs of a kind are kept.

    Args:
        kind: begins the name of their folders.
        origin: all that determines the programs besides what their own names tell, such as the sources.
        root: gives the folder that theirs lies in; None where nothing is kept.
    """

    def __init__(self, kind: str, origin: str, root: Callable[[], Path | None]) -> None:
        self._kind, self._origin, self._root = kind, origin, root

    def read(self, name: str) -> bytes | None:
        """A program; None if there is none that this user has written."""
        folder = self._folder()
        return None if folder is None else sealed.read(folder / name)

    def write(self, name: str, contents: bytes) -> None:
        """Keep a program, where that can be done."""
        folder = self._folder()
        if folder is not None:
            _make_room(folder, self._kind)
            sealed.write(folder / name, contents)

    def _folder(self) -> Path | None:
        root = self._root()
        return None if root is None else root / f"{self._kind}-{self._origin}"


def _make_room(folder: Path, kind: str) -> None:
    """Before a new folder is made, delete those of earlier origins except the latest few."""
    if folder.exists():
        return
    others = sorted(folder.parent.glob(f"{kind}-*"), key=lambda f: f.stat().st_mtime)
    for old in others[: max(len(others) - EARLIER, 0)]:
        shutil.rmtree(old, ignore_errors=True)
