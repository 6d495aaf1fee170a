"""Files written whole or not at all."""

from __future__ import annotations

import os

from gtr_jax.leftovers import replaced_whole

__all__ = ["replaced_whole", "write_whole"]


def write_whole(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file whole or not at all."""
    with replaced_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")
