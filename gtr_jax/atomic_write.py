"""Files written whole or not at all."""

from __future__ import annotations

import os

from gtr_jax.leftovers import replaced_atomically

__all__ = ["replaced_atomically", "write_atomically"]


def write_atomically(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file whole or not at all."""
    with replaced_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")
