"""How objects show themselves in a notebook, without depending on what draws them."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any


def drawn_by(place: str) -> Callable[[Any], str | None]:
    """The method `_repr_html_` of a class, with the function that draws it; it is imported when it is asked.

    Args:
        place: module and function, "gtr_jax.report.object_cards:robot_card".
    """
    module, _, name = place.partition(":")

    def _repr_html_(self: Any) -> str | None:
        return getattr(import_module(module), name)(self)

    return _repr_html_
