"""Other interpreters that this one starts, and where the command looks for code: never in the current folder,
whose files somebody else may have written.

Python puts the current folder first on the path of `python -c` and `python -m`. Without it, what this process
can import is found all the same: also from a checkout that is not installed, and in folders that the user
names in PYTHONPATH, which isolated interpreters (-I) ignore.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))  # what this package is imported from
SAFE, PATH = "PYTHONSAFEPATH", "PYTHONPATH"


def python(*arguments: str) -> list[str]:
    """A command line of this interpreter, named by its whole path, without the current folder on its path.
    Start it with `surroundings`.
    """
    return [os.path.abspath(sys.executable), "-P", *arguments]


def surroundings() -> dict[str, str]:
    """The environment of another interpreter, which finds what this one finds."""
    return {**os.environ, **_safe()}


@contextlib.contextmanager
def started_safely() -> Iterator[None]:
    """In this block libraries that start interpreters, as `multiprocessing` does, start safe ones."""
    names = (SAFE, PATH)
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(_safe())
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def program(name: str) -> str | None:
    """Whole path of a program on the PATH; None if there is none. Folders that the PATH does not name in full
    are left out: they mean whatever folder one is in.
    """
    import shutil

    folders = [folder for folder in os.environ.get("PATH", os.defpath).split(os.pathsep) if _whole(folder)]
    found = shutil.which(name, path=os.pathsep.join(folders))
    # On Windows `which` looks in the current folder first.
    return found if found and os.path.dirname(found) in folders else None


def is_the_command() -> bool:
    """Whether this process is the command `gtr`, as a script or as `python -m gtr_jax`."""
    script = os.path.basename(sys.argv[0]) if sys.argv else ""
    if script in ("gtr", "gtr.exe"):
        return True
    # Python calls a module so while it looks for it, and imports its package.
    given = sys.orig_argv
    return script == "-m" and "-m" in given[:-1] and given[given.index("-m") + 1] == "gtr_jax"


def leave_the_current_folder() -> None:
    """If this process is the command `gtr`, look for code no longer where it would be found only because it
    is in the current folder.
    """
    if is_the_command():
        sys.path[:] = search_path(sys.path)


def search_path(path: Sequence[str]) -> list[str]:
    """A path of Python's without the current folder and without what PYTHONPATH names relative to it: an
    empty name there is the current folder, too. Folders stay that come after the standard library, where
    installed packages are, or in full in PYTHONPATH, and the one that this package is imported from.

    Args:
        path: as `sys.path`.
    """
    named = os.environ.get(PATH, "").split(os.pathsep)
    here = {_current(), *(os.path.abspath(folder) for folder in named if not _whole(folder))}
    here -= {ROOT, *(os.path.normpath(folder) for folder in named if _whole(folder))}
    library = os.path.dirname(os.path.abspath(os.__file__))
    begins = path.index(library) if library in path else len(path)
    return [folder for k, folder in enumerate(path) if folder and not (k < begins and folder in here)]


def _safe() -> dict[str, str]:
    """What in the environment makes an interpreter safe."""
    # A folder whose name holds the separator cannot be named.
    folders = [folder for folder in search_path(sys.path) if os.pathsep not in folder and _whole(folder)]
    return {SAFE: "1", PATH: os.pathsep.join(folders)}


def _current() -> str:
    try:
        return os.getcwd()
    except OSError:  # it is gone
        return ""


def _whole(folder: str) -> bool:
    return os.path.isabs(folder)
