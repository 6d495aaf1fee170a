"""What is going on, on stderr, for whatever takes longer than two seconds."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Iterator
from typing import TextIO

import click

from gtr_jax.interruption import interruption

PATIENCE = 2.0  # seconds before the first word
# Seconds between plain lines: at least, and until one is said again; then twice that.
PAUSE, REPEAT = 2.0, 10.0


@contextlib.contextmanager
def kept() -> Iterator[None]:
    """Say on an interruption that what a long run has done is not lost."""
    says = "what is done is kept: the same command resumes from there"
    with interruption.undoing(lambda: os.write(2, f"{says}\n".encode())):
        try:
            yield
        except (KeyboardInterrupt, click.Abort):
            click.echo(says, err=True)
            raise


class Progress:
    """Says which stage a command is in: a spinner on a terminal, plain lines elsewhere.

    A context manager; inside it, call it with the name of each stage. Until the first stage it is silent, so
    that refused input gets one line; so is a quick command. Nothing stays on a terminal's screen.
    """

    def __init__(self, stream: TextIO | None = None, *, patience: float = PATIENCE) -> None:
        self._stream = stream or sys.stderr
        self._patience = patience
        self._stage = ""
        self._changed, self._over = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._start = time.monotonic()

    def __call__(self, stage: str) -> None:
        self._stage = stage
        self._changed.set()

    def __enter__(self) -> Progress:
        self._start = time.monotonic()
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._over.set()
        self._changed.set()
        self._thread.join()

    def _line(self) -> str:
        return f"{self._stage} ({time.monotonic() - self._start:.0f} s)"

    def _watch(self) -> None:
        self._over.wait(self._patience)
        self._changed.wait()  # a first stage, or the end
        if self._over.is_set():
            return
        if self._stream.isatty():
            self._spin()
        else:
            self._lines()

    def _spin(self) -> None:
        from rich.console import Console

        console = Console(file=self._stream)
        with interruption.undoing(self._cleared), console.status(self._line()) as status:
            while not self._over.wait(0.2):
                status.update(self._line())

    def _cleared(self) -> None:
        os.write(2, b"\r\x1b[2K\x1b[?25h")  # the line, and the cursor that it hides

    def _lines(self) -> None:
        said, wait = "", REPEAT
        while not self._over.is_set():
            self._changed.clear()
            wait = 2 * wait if self._stage == said else REPEAT
            said = self._stage
            print(self._line(), file=self._stream, flush=True)
            self._over.wait(PAUSE)
            self._changed.wait(wait - PAUSE)
