"""Readers in a process of their own: of a damaged file, some libraries take the whole interpreter down, or
write on stderr what they have to say.
"""

from __future__ import annotations

import atexit
import functools
import importlib
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from gtr_jax.errors import InputError, reason
from gtr_jax.interpreters import python, surroundings

from .expansion import limit_memory, too_much_memory

_SERVE = "from gtr_jax.recordings.formats.subprocess_reader import serve; serve()"
_lock = threading.Lock()


def read_in_subprocess(
    reader: Callable[[Any], Any], data: Any, *, path: Path, intact: str, remedy: str
) -> Any:
    """What a reader makes of a file in a process that lives on for the next file.

    Args:
        reader: a function of a module.
        data: what it is given: the bytes of the file, or its path.
        path: of the file, which errors name.
        intact: what the file is not if the reader fails: "a complete TDMS file".
        remedy: what to do then.

    Raises InputError naming the file if the reader raises an error, takes its process down, or needs more
    memory than `expansion` allows.
    """
    try:
        return _answer(reader, data)
    except _Unreadable as fault:
        raise InputError(f"{path}: not {intact} ({fault}); {remedy}") from None
    except InputError as fault:
        raise InputError(f"{path}: {fault}") from None


class _Unreadable(Exception):
    """A reader failed, for the reason that this says."""


def _answer(reader: Callable[[Any], Any], data: Any) -> Any:
    """What a reader answers.

    Raises _Unreadable if it fails, and InputError, without the place, if it does or needs too much memory.
    """
    with _lock:
        process = _process()
        try:
            assert process.stdin is not None and process.stdout is not None
            _send(process.stdin, (reader.__module__, reader.__qualname__, data))
            fault, answer = pickle.load(process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            _end()
            raise _Unreadable("it is damaged, or needs too much memory") from None
        except BaseException:  # Ctrl-C: what it answers later is of no use to the next file
            _end()
            raise
    if isinstance(answer, InputError):
        raise answer
    if fault:
        raise _Unreadable(fault)
    return answer


@functools.cache
def _process() -> subprocess.Popen:
    return subprocess.Popen(
        python("-c", _SERVE),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=surroundings(),
    )


def _end() -> None:
    """End the process; the next file gets another."""
    if _process.cache_info().currsize:
        process = _process()
        _process.cache_clear()
        process.kill()
        process.communicate()


atexit.register(_end)


def _send(stream: IO[bytes], message: Any) -> None:
    pickle.dump(message, stream, protocol=5)
    stream.flush()


def serve() -> None:
    """Read files for another process, until it closes the stream."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what libraries print is not an answer
    limit_memory()
    while True:
        try:
            module, name, data = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        try:
            message = ("", getattr(importlib.import_module(module), name)(data))
        except InputError as fault:
            message = ("", fault)
        except MemoryError:
            message = ("", too_much_memory())
        except BaseException as fault:  # a panic of Rust is not an Exception
            message = (reason(fault), None)
        _send(answers, message)
