"""Functions found by where they stand, for objects that know what can be made of them and not how."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any


def elsewhere(place: str) -> Callable[..., Any]:
    """A function, imported now.

    Args:
        place: module and function, "gtr_jax.report.object_cards:robot_card".
    """
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)
