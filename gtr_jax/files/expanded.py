"""Compressed files, expanded as far as memory should go: a small file may hold endless zeros."""

from __future__ import annotations

import contextlib
import gzip
import io
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

from gtr_jax.errors import InputError

GZIP = b"\x1f\x8b"
ZIP = b"PK\x03\x04"
MOST_EXPANDED = 2**30
"""Bytes that a compressed file may expand to: a CSV file of 12 million rows of 5 columns."""
_MEMORY = 4 * MOST_EXPANDED  # bytes that a reader may take


def expanded_gzip(path: Path, data: bytes) -> bytes:
    """The bytes that gzip compressed.

    Raises InputError naming the file if it is damaged, or expands to more than MOST_EXPANDED.
    """
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
            found = stream.read(MOST_EXPANDED + 1)
    except (OSError, EOFError, zlib.error) as fault:
        raise InputError(f"{path}: not a whole gzip file ({fault}); compress it again") from None
    if len(found) > MOST_EXPANDED:
        raise _too_large(path)
    return found


def members(path: Path, data: bytes) -> list[str]:
    """Names of the files in a zip archive, which is not expanded.

    Raises InputError naming the file if it is damaged, or its files expand to more than MOST_EXPANDED.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            infos = archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as fault:
        raise InputError(f"{path}: not a whole workbook or archive ({fault}); export it again") from None
    if sum(info.file_size for info in infos) > MOST_EXPANDED:
        raise _too_large(path)
    return [info.filename for info in infos]


@contextlib.contextmanager
def little_memory() -> Iterator[None]:
    """Limits the memory that this process may take meanwhile, where the system can: for what a file states to
    hold, or leaves out between cells far apart, readers take memory at once.
    """
    try:
        import resource

        taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        most = taken + _MEMORY
        if soft != resource.RLIM_INFINITY:
            most = min(most, soft)
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    except (ImportError, OSError, ValueError):
        yield
        return
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _too_large(path: Path) -> InputError:
    return InputError(
        f"{path}: expands to more than {MOST_EXPANDED // 2**20} MiB; export fewer rows, or log more slowly"
    )
