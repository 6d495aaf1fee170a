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
CELLS = (
    5_000_000  # of a text that is read cell by cell; 5 million rows of one take 1.8 GB, 0.7 GB in ten columns
)
_REMEDY = "export fewer columns, a shorter stretch, or fewer samples"


def check_numbers(count: int, says: str) -> None:
    """InputError, without the place, if a table would have more than `NUMBERS` numbers.

    Args:
        count: of the numbers, as the file says before it is expanded.
        says: what has them, for the message.
    """
    if count > NUMBERS:
        raise InputError(f"{says}; at most {NUMBERS // 1_000_000} million numbers are read, so {_REMEDY}")


def check_cells(path: Path, text: str, delimiters: str) -> None:
    """InputError naming the file if a text that is read cell by cell would have more than `CELLS` cells.

    Args:
        path: of the file.
        text: of it.
        delimiters: what may part its cells; the most frequent counts.
    """
    count = text.count("\n") + max(map(text.count, delimiters))
    if count > CELLS:
        raise InputError(
            f"{path}: has about {count / 1e6:.3g} million cells; at most {CELLS / 1e6:.3g} million are read "
            "from a text that is not a plain table (one header, then rows of as many cells, without quotes, "
            f"comments, blank lines or words), so export it as one, or {_REMEDY}"
        )


def check_separators(path: Path, data: bytes) -> None:
    """InputError naming the file if an expanded text has more than `NUMBERS` line breaks, commas, semicolons
    and tabs, about as many as cells.
    """
    count = sum(map(data.count, (b"\n", b",", b";", b"\t")))
    try:
        check_numbers(count, f"expands to about {count / 1e6:.3g} million cells")
    except InputError as fault:
        raise InputError(f"{path}: {fault}") from None


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
        raise InputError(f"{path}: not a complete gzip file ({fault}); compress it again") from None
    if len(found) > LARGEST:
        raise _too_large(path)
    return found


def archive_members(path: Path, data: bytes) -> list[str]:
    """Names of the files in a zip archive, which is not expanded.

    Raises InputError naming the file if it is damaged, or its files expand to more than a file may have.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            infos = archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as fault:
        raise InputError(f"{path}: not a complete workbook or archive ({fault}); export it again") from None
    if sum(info.file_size for info in infos) > LARGEST:
        raise _too_large(path)
    return [info.filename for info in infos]


def _too_large(path: Path) -> InputError:
    return InputError(f"{path}: expands to more than {LARGEST >> 20} MiB; {_REMEDY}")


def too_much_memory() -> InputError:
    """The error of a file that would not say how much it becomes."""
    return InputError(f"expands to more than {MEMORY >> 30} GiB; {_REMEDY}")


def limit_memory() -> None:
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
