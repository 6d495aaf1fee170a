"""Files that another file names: they lie in its folder, or in one that the user has stated."""

from __future__ import annotations

import contextlib
import contextvars
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from gtr_jax.errors import InputError, excerpt

VARIABLE = "GTR_JAX_ROOT"  # a folder from which files may be named too
SHIPPED = Path(__file__).resolve().parents[1] / "examples"  # of this package, to which examples/ links
LARGEST = 256 << 20  # bytes of a file that another one names

_CHOSEN: contextvars.ContextVar[frozenset[Path]] = contextvars.ContextVar("chosen", default=frozenset())


@contextlib.contextmanager
def chosen_by_user(files: Iterable[Path]) -> Iterator[None]:
    """Within it, these files, which the user has named and no other file, may lie anywhere."""
    token = _CHOSEN.set(frozenset(file.resolve() for file in files))
    try:
        yield
    finally:
        _CHOSEN.reset(token)


def referenced(name: str, folder: Path, where: str) -> Path:
    """The path of a file that another file names.

    A robot file may come from somebody else: what it names is looked for only beneath its own folder, or
    beneath the folder that the variable `GTR_JAX_ROOT` states, wherever links lead. A file
    that the user has chosen (`chosen_by_user`) may lie anywhere.

    Args:
        name: relative to the folder.
        folder: of the file that names it.
        where: that file and the key, for errors; "" where whoever calls adds it.

    Raises InputError, of a file outside these folders, of what is not a regular file, and of one that is
    larger than `LARGEST`. An absent file is left to whoever reads it.
    """
    place = f"{where}: " if where else ""
    path, stated = folder / name, os.environ.get(VARIABLE)
    try:
        resolved = path.resolve()
        roots = [folder.resolve(), SHIPPED, *([Path(stated).resolve()] if stated else [])]
        found = resolved.stat() if resolved.exists() else None
    except (OSError, ValueError, RuntimeError):  # a name with a null byte, a link to itself
        raise InputError(f"{place}'{excerpt(name)}' cannot be the name of a file; correct it") from None
    if resolved not in _CHOSEN.get() and not any(resolved.is_relative_to(root) for root in roots):
        raise InputError(
            f"{place}'{excerpt(name)}' is not in the folder of the file that names it; copy it there, or set "
            f"{VARIABLE} to a folder that holds both"
        )
    if found is not None and not resolved.is_file():
        raise InputError(f"{place}'{excerpt(name)}' is a folder, a pipe or a device; name a file")
    if found is not None and found.st_size > LARGEST:
        raise InputError(
            f"{place}'{excerpt(name)}' has more than {LARGEST >> 20} MiB, which is the most; "
            "write fewer rows into it"
        )
    return path
