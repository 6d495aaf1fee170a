"""Standard streams of the command that may be closed, or that nobody reads."""

from __future__ import annotations

import io
import os
import sys
from typing import Any


class _ForgetfulStream(io.FileIO):
    """A standard stream that drops what is written once nobody reads it, as in `gtr ... | head -1`."""

    def write(self, data: Any) -> int:
        """Write, or forget."""
        try:
            return super().write(data) or 0
        except BrokenPipeError:
            return len(data)


def withstand_closed_streams() -> None:
    """Discard the answers of this process where standard output or error are closed or no longer
    read: a command then does all that it does, run folder and exit status included.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:
            _fill(number)
            setattr(sys, name, open(number, mode, encoding="utf-8", errors="replace", closefd=False))
        elif number and isinstance(stream, io.TextIOWrapper):
            raw = _ForgetfulStream(number, "w", closefd=False)
            buffer: Any = raw if isinstance(stream.buffer, io.RawIOBase) else io.BufferedWriter(raw)
            replaced = io.TextIOWrapper(
                buffer,
                encoding=stream.encoding,
                errors=stream.errors,
                line_buffering=stream.line_buffering,
                write_through=stream.write_through,
            )
            setattr(sys, name, replaced)


def _fill(number: int) -> None:
    """Open the null device at a number that is closed, which the next file that is opened would get."""
    try:
        os.fstat(number)
    except OSError:
        null = os.open(os.devnull, os.O_RDWR)
        if null != number:
            os.dup2(null, number)
            os.close(null)
