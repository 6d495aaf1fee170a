"""How objects show themselves in a notebook, without depending on what draws them.

A class takes `as_card` as its method `_repr_html_`. The function that draws its card is in a report, above
the class, and registers with `draws`. The door of each package says to `cards_come_with` which file that
is. The file is imported only when a notebook asks, because what draws takes a second to import.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

Drawing = TypeVar("Drawing", bound=Callable[..., str | None])

_imports: list[Callable[[], None]] = []


@functools.singledispatch
def card_of(thing: Any) -> str | None:
    """What a notebook shows of an object, as HTML; None where there is nothing to draw."""
    return None


_NO_CARD = card_of.dispatch(object)


def draws(kind: type) -> Callable[[Drawing], Drawing]:
    """Register the decorated function as the one that draws the card of objects of a class."""

    def register(drawing: Drawing) -> Drawing:
        card_of.register(kind, drawing)
        return drawing

    return register


def cards_come_with(imports: Callable[[], None]) -> None:
    """Say what imports the file that has the cards of a package."""
    _imports.append(imports)


def as_card(thing: Any) -> str | None:
    """The card of an object; imports what draws it."""
    for imports in _imports:
        if card_of.dispatch(type(thing)) is not _NO_CARD:
            break
        imports()
    return card_of(thing)
