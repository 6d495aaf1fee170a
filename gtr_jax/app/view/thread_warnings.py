"""Warnings of input that are heard in one thread, whatever other threads do meanwhile.

`warnings.catch_warnings` changes what holds for all threads: two pages that used it at once could leave each
other's state behind.
"""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Iterator
from typing import Any

from gtr_jax.errors import InputWarning

_listening = threading.local()


@contextlib.contextmanager
def thread_warnings() -> Iterator[list[str]]:
    """The texts of the input warnings that this thread gives meanwhile, each once; they are shown nowhere
    else.
    """
    if not getattr(warnings.showwarning, "hears", False):
        warnings.showwarning = _shown_by_thread(warnings.showwarning)
    _listening.to = texts = []
    try:
        yield texts
    finally:
        _listening.to = None


def _shown_by_thread(otherwise: Any) -> Any:
    """What shows warnings: to a thread that listens, or else as before."""

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        texts = getattr(_listening, "to", None)
        if texts is None or not issubclass(category, InputWarning):
            otherwise(message, category, *where, **more)
        elif str(message) not in texts:
            texts.append(str(message))

    show.hears = True  # type: ignore[attr-defined]
    return show
