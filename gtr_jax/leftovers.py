"""Temporary files and folders that take their place when they are whole, and what killed processes left of
them: it is removed by the next process that writes beside it, never while the one that made it may run.

Their names say on which machine, since which start of it, and by which process they were made. Of another
machine that shares the folder, or another container, nobody here can tell what runs there: theirs stay.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import itertools
import os
import platform
import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

NAME = re.compile(r"\.(.+)\.([0-9a-f]{8})([0-9a-f]{6})-(\d+)-\d+\.(part|old|html)", re.DOTALL)
_number = itertools.count(1)


def beside(path: Path, ending: str = "part") -> Path:
    """A free name in the folder of a file or folder: `part` for what is to take its place, `old` for what it
    takes the place of, `html` for a page that stays for as long as this process needs it.
    """
    return path.with_name(f".{path.name}.{_machine()}{_start()}-{os.getpid()}-{next(_number)}.{ending}")


@contextlib.contextmanager
def replaced_atomically(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary file beside a file, for the block to write; it then takes the file's name, unless the block
    raises: then the file stays as it was.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    _clear_once(path.parent.absolute())
    temporary = beside(path)
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def clear(folder: Path) -> None:
    """Remove from a folder what processes that run no more have left there. What was moved aside to be
    replaced, and was not, gets its name back.
    """
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            named = NAME.fullmatch(entry.name)
            if named is None:
                continue
            with contextlib.suppress(OSError):
                changed = entry.stat(follow_symlinks=False).st_mtime
                if not _is_dead(named[2], named[3], named[4], changed):
                    continue
                path, target = Path(entry.path), Path(folder, named[1])
                if named[5] == "old" and not target.exists():
                    path.rename(target)
                elif entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(path)
                else:
                    path.unlink()


@functools.cache
def _clear_once(folder: Path) -> None:
    clear(folder)


def _is_dead(machine: str, start: str, pid: str, changed: float) -> bool:
    """Whether the process that a name stands for has ended."""
    if machine != _machine():
        return False
    if start == _start():
        return not _runs(int(pid))
    # Before this machine was started again, if it is this machine and not one with all of its names.
    return changed < time.time() - _running_for()


def _runs(pid: int) -> bool:
    if os.name != "posix":
        return True  # there is no way to ask that does no harm
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        pass
    return True


@functools.cache
def _machine() -> str:
    """Tells this machine from others, and a container from others, whose processes have numbers of their
    own.
    """
    whole = platform.node()
    with contextlib.suppress(OSError):
        whole += Path("/etc/machine-id").read_text()
    with contextlib.suppress(OSError):
        whole += str(os.stat("/proc/self/ns/pid").st_ino)
    return _digits(whole, 8)


@functools.cache
def _start() -> str:
    """Tells apart the times that this machine was started."""
    try:
        return _digits(Path("/proc/sys/kernel/random/boot_id").read_text(), 6)
    except OSError:
        return "0" * 6


def _running_for() -> float:
    """For how long this machine has been running [s]; for ever where it does not say."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return float("inf") if clock is None else time.clock_gettime(clock)


def _digits(text: str, count: int) -> str:
    return hashlib.blake2b(text.encode(errors="replace"), digest_size=count // 2).hexdigest()
