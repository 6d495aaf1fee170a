"""Text files as people's programs write them: bytes to text."""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path

from gtr_jax.errors import InputError

WORKBOOKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")  # how .xlsx and .xls files begin
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """The bytes of a file; InputError if it is absent or cannot be read."""
    try:
        return Path(path).read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check the path") from None
    except (OSError, ValueError) as fault:
        reason = getattr(fault, "strerror", None) or fault
        raise InputError(f"{path}: cannot be read ({reason}); name a readable file") from None


def digest(path: Path) -> str:
    """SHA-256 of a file's bytes; of a folder, that of its files in the order of their names."""
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    sha256 = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                sha256.update(block)
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
    """Text of bytes; with a control character in it if they are no text."""
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
