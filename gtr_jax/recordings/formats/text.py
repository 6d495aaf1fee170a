"""Text files as people's programs write them: bytes to text."""

from __future__ import annotations

import hashlib
import os
import re
import stat
from pathlib import Path
from typing import IO

from gtr_jax.errors import InputError

WORKBOOKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")  # how .xlsx and .xls files begin
# Bytes of a file that is read whole. Its text and cells take six times that (measured with numbers of eight
# characters), and fifteen times where each cell is one digit.
LARGEST = 1 << 30
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")


def open_file(path: str | os.PathLike[str], *, limited: bool = True) -> IO[bytes]:
    """A file opened for reading.

    Args:
        path: the file.
        limited: whether one of more than `LARGEST` bytes is refused.

    Raises InputError if it is absent, cannot be read, or is not a regular file: a pipe or a device may never
    end.
    """
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            _refuse_kind(path)
        stream = open(path, "rb", opener=_open_without_waiting)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check the path") from None
    except InputError:
        raise
    except (OSError, ValueError) as fault:
        raise _unreadable(path, fault) from None
    found = os.fstat(stream.fileno())  # of what was opened, whatever has taken its place meanwhile
    if not stat.S_ISREG(found.st_mode) or (limited and found.st_size > LARGEST):
        stream.close()
        if not stat.S_ISREG(found.st_mode):
            _refuse_kind(path)
        raise _too_large(path)
    return stream


def _open_without_waiting(path: str, flags: int) -> int:
    """A file descriptor, without waiting for who writes into a pipe."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _refuse_kind(path: str | os.PathLike[str]) -> None:
    if os.path.isdir(path):
        raise InputError(f"{path}: cannot be read (Is a directory); name a readable file")
    raise InputError(
        f"{path}: is a pipe or a device, not a file; write what it gives into a file, or send it to the "
        "command and name it -"
    )


def _unreadable(path: str | os.PathLike[str], fault: Exception) -> InputError:
    reason = getattr(fault, "strerror", None) or fault
    return InputError(f"{path}: cannot be read ({reason}); name a readable file")


def _too_large(path: str | os.PathLike[str]) -> InputError:
    return InputError(
        f"{path}: has more than {LARGEST >> 30} GiB; export fewer columns, a shorter stretch, or "
        "fewer samples"
    )


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """The bytes of a file; InputError if it cannot be read, as of `open_file`."""
    with open_file(path) as stream:
        return read_all(stream, path)


def read_all(stream: IO[bytes], path: str | os.PathLike[str]) -> bytes:
    """All that comes from a stream; InputError naming `path` if that is more than `LARGEST` bytes."""
    try:
        data = stream.read(LARGEST + 1)
    except OSError as fault:
        raise _unreadable(path, fault) from None
    if len(data) > LARGEST:
        raise _too_large(path)
    return data


def digest(path: Path) -> str:
    """SHA-256 of a file's bytes; of a folder, that of its files in the order of their names.

    Raises InputError as `open_file`, but for the size.
    """
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    sha256 = hashlib.sha256()
    for file in files:
        with open_file(file, limited=False) as stream:
            try:
                while block := stream.read(1 << 20):
                    sha256.update(block)
            except OSError as fault:
                raise _unreadable(file, fault) from None
    return sha256.hexdigest()


def read_text(path: str | os.PathLike[str]) -> tuple[str, str]:
    """Text of a file in UTF-8, UTF-16 or Latin-1 and the SHA-256 of its bytes; InputError if it is absent,
    empty or not text.
    """
    path = Path(path)
    data = read_bytes(path)
    return text_of(path, data), hashlib.sha256(data).hexdigest()


def text_of(path: Path, data: bytes) -> str:
    """The text that the bytes of a file are; InputError naming the file if they are none."""
    if data.startswith(WORKBOOKS):
        raise InputError(f"{path}: not a text file but a workbook or an archive; export the sheet as CSV")
    text = _decoded(data)
    if _CONTROL.search(text):
        raise InputError(f"{path}: not a text file; save it as plain text in UTF-8")
    if not text.strip():
        raise InputError(f"{path}: the file is empty")
    return text


def _decoded(data: bytes) -> str:
    """Text of bytes; with a control character in it if they are not text."""
    odd, even = data[1:200:2], data[0:200:2]
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encodings = ("utf-16",)
    elif odd and not any(odd) and all(even):  # UTF-16 without a mark, of a language in Latin letters
        encodings = ("utf-16-le",)
    elif len(data) > 1 and not any(even) and all(odd):
        encodings = ("utf-16-be",)
    else:
        encodings = ("utf-8-sig", "cp1252", "latin-1")
    for encoding in encodings:
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    return "\0"
