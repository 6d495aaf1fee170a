"""How much a file may become in memory: a compressed file of a megabyte may hold gigabytes."""

from __future__ import annotations

import gzip
import io
import os
import zipfile
import zlib
from pathlib import Path

from gtr_jax.errors import InputError

from .text import LARGEST

GZIP = b"\x1f\x8b"
ZIP = b"PK\x03\x04"

NUMBERS = 50_000_000  # of a table: eight cells at 1 kHz for more than an hour and a half
MEMORY = 4 << 30  # bytes that a reader in a process of its own may take, besides what each core asks for
EACH_CORE = 64 << 20
_REMEDY = "export fewer columns, a shorter stretch, or fewer samples"


def check_numbers(count: int, says: str) -> None:
    """InputError, without the place, if a table would have more than `NUMBERS` numbers.

    Args:
        count: of the numbers, as the file says before it is expanded.
        says: what has them, for the message.
    """
    if count > NUMBERS:
        raise InputError(f"{says}; at most {NUMBERS // 1_000_000} million numbers are read, so {_REMEDY}")


def check_bytes(size: int) -> None:
    """The same, if it would have as many bytes expanded as `NUMBERS` numbers have."""
    if size > 8 * NUMBERS:
        raise InputError(
            f"expands to {size / 1e6:.4g} MB; at most {8 * NUMBERS / 1e6:.4g} MB are read, so {_REMEDY}"
        )


def expanded_gzip(path: Path, data: bytes) -> bytes:
    """The bytes that gzip compressed.

    Raises InputError naming the file if it is damaged, or expands to more than a file may have.
    """
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
            found = stream.read(LARGEST + 1)
    except (OSError, EOFError, zlib.error) as fault:
        raise InputError(f"{path}: not a whole gzip file ({fault}); compress it again") from None
    if len(found) > LARGEST:
        raise _too_large(path)
    return found


def members(path: Path, data: bytes) -> list[str]:
    """Names of the files in a zip archive, which is not expanded.

    Raises InputError naming the file if it is damaged, or its files expand to more than a file may have.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            infos = archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as fault:
        raise InputError(f"{path}: not a whole workbook or archive ({fault}); export it again") from None
    if sum(info.file_size for info in infos) > LARGEST:
        raise _too_large(path)
    return [info.filename for info in infos]


def _too_large(path: Path) -> InputError:
    return InputError(f"{path}: expands to more than {LARGEST >> 20} MiB; {_REMEDY}")


def too_much() -> InputError:
    """The error of a file that would not say how much it becomes."""
    return InputError(f"expands to more than {MEMORY >> 30} GiB; {_REMEDY}")


def confine() -> None:
    """Keep this process from taking more memory than that, and from writing larger files, where the system
    can.
    """
    try:
        import resource
    except ImportError:  # Windows
        return
    for name, most in (
        ("RLIMIT_DATA", MEMORY + EACH_CORE * (os.cpu_count() or 1)),
        ("RLIMIT_FSIZE", MEMORY),
    ):
        kind = getattr(resource, name, None)
        if kind is not None:
            _, hard = resource.getrlimit(kind)
            resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
