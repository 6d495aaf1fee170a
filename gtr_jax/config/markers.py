"""Markers of a robot file: names that can begin a column, places on the body."""

from __future__ import annotations

import re
from collections.abc import Sequence

from gtr_jax.errors import InputError
from gtr_jax.recordings.formats.quantities import SPELLINGS, marker_quantities, plain_name

from .checks import mm
from .sections import MarkerConfig

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


def check_markers(markers: Sequence[MarkerConfig], length: float) -> None:
    """Refuse markers whose columns could not be told apart, or that lie beyond the body; InputError naming
    the key and the remedy.
    """
    seen: dict[str, str] = {}
    for i, marker in enumerate(markers):
        key = f"markers[{i}]"
        if not _NAME.fullmatch(marker.name):
            raise InputError(
                f"{key}.name: '{marker.name}' cannot begin a column's name; take letters, digits, _ and -, "
                "and a letter first"
            )
        plain = plain_name(marker.name)
        if plain in seen:
            raise InputError(
                f"{key}.name: '{marker.name}' has the same columns as '{seen[plain]}'; give each marker its "
                "own name"
            )
        seen[plain] = marker.name
        taken = [name for name in marker_quantities(marker.name) if plain_name(name) in SPELLINGS]
        if taken:
            raise InputError(
                f"{key}.name: '{marker.name}' clashes with the column {taken[0]} of every recording; take "
                "another name"
            )
        if not 0 <= marker.at <= length * (1 + 1e-9):
            raise InputError(
                f"{key}.at: {mm(marker.at)} lies outside the backbone; keep it within 0 mm and {mm(length)}"
            )
