"""How objects show themselves in a notebook, without depending on what draws them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .elsewhere import elsewhere


def drawn_by(place: str) -> Callable[[Any], str | None]:
    """The method `_repr_html_` of a class, with the function that draws it; it is imported when it is asked.

    Args:
        place: as `elsewhere` takes it.
    """

    def _repr_html_(self: Any) -> str | None:
        return elsewhere(place)(self)

    return _repr_html_
