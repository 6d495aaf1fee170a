"""Folders that are the user's own, and that nobody else can change: programs and keys are kept in no other.

On Windows the folders of a user's profile are closed to other users by the system, and nothing is looked at.
"""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
from pathlib import Path

OTHERS = stat.S_IWGRP | stat.S_IWOTH
OVERFLOW = Path("/proc/sys/kernel/overflowuid")  # of whom the kernel has no number for, on Linux
POSIX = os.name == "posix"


class NotOwn(Exception):
    """A folder that others can change, or might have changed: which, and why."""


def own_folder(folder: Path) -> Path:
    """A folder that only the user can enter: made, or, if it is there and the user's, closed to others and
    rid of files that they put there or could write to.

    Returns:
        Its path, without links.

    Raises:
        NotOwn: it, or a folder above it, belongs to somebody else or can be changed by somebody else.
        OSError: it cannot be made.
    """
    folder = folder.absolute()
    for above in (*reversed(folder.parents), folder):
        if not above.exists():
            above.mkdir(0o700, exist_ok=True)
    folder = folder.resolve()
    if not folder.is_dir():
        raise NotADirectoryError(f"{folder} is not a folder")
    if POSIX:
        for place in (folder, *folder.parents):
            if why := _changed_by(place, sealed=place == folder):
                raise NotOwn(why)
        mode = folder.stat().st_mode
        if mode & 0o077:
            folder.chmod(0o700)
        _rid(folder, opened=bool(mode & 0o077))
    return folder


def private_place(name: str = "gtr-jax") -> Path | None:
    """The user's own folder for what is not a cache; where there is none to be had, one beside temporary
    files; None if there is none either.
    """
    from platformdirs import user_data_path

    for folder in (user_data_path(name, appauthor=False), beside_temporary_files(name)):
        try:
            return own_folder(folder)
        except (NotOwn, OSError):
            continue
    return None


def beside_temporary_files(name: str = "gtr-jax") -> Path:
    """A folder for a user who has no other."""
    return Path(tempfile.gettempdir()) / (f"{name}-{os.geteuid()}" if POSIX else name)


def is_own(status: os.stat_result) -> bool:
    """Whether a file or folder is the user's own."""
    return not POSIX or status.st_uid == os.geteuid()


def _changed_by(place: Path, *, sealed: bool) -> str:
    """Who besides the user and the system's administrator can change what a folder holds; "" if nobody can.

    Args:
        place: the folder.
        sealed: whether it has to be the user's own; its mode is then of no matter, as it can be changed.
    """
    status = place.stat()
    of_system = status.st_uid == 0 or (place == Path(place.anchor) and _is_unmapped_root(status))
    if status.st_uid != os.geteuid() and (sealed or not of_system):
        return f"{place} belongs to {_user(status.st_uid)}"
    # In a sticky folder, as /tmp, nobody can replace what belongs to others.
    if sealed or status.st_mode & stat.S_ISVTX or not _open_to_others(status):
        return ""
    return f"others can write to {place}"


def _is_unmapped_root(status: os.stat_result) -> bool:
    """Whether the owner of / is one whom the kernel has no number for, as in a container of a user without
    rights, and others cannot write to it: the system's administrator outside.
    """
    try:
        overflow = int(OVERFLOW.read_text())
    except (OSError, ValueError):
        return False
    return status.st_uid == overflow and not status.st_mode & OTHERS


def _open_to_others(status: os.stat_result) -> bool:
    """Whether somebody besides the user and the administrator may write to a file or folder."""
    if status.st_mode & stat.S_IWOTH:
        return True
    return bool(status.st_mode & stat.S_IWGRP) and not _alone_in(status.st_gid)


def _alone_in(gid: int) -> bool:
    """Whether a group is the administrator's or the user's alone, as many systems give each user one."""
    if gid == 0:
        return True
    import grp
    import pwd

    try:
        user, group = pwd.getpwuid(os.geteuid()), grp.getgrgid(gid)
    except KeyError:
        return False
    return gid == user.pw_gid and group.gr_name == user.pw_name and {*group.gr_mem} <= {user.pw_name}


def _user(uid: int) -> str:
    import pwd

    try:
        return f"user {pwd.getpwuid(uid).pw_name}"
    except KeyError:
        return f"user {uid}"


def _rid(folder: Path, *, opened: bool) -> None:
    """Remove from a folder what is not the user's, and, if it was open to others until now, what they could
    have written to.
    """
    me = os.geteuid()
    with os.scandir(folder) as entries:
        for entry in entries:
            try:
                status = entry.stat(follow_symlinks=False)
                is_folder = stat.S_ISDIR(status.st_mode)
                linked = stat.S_ISLNK(status.st_mode)
                if status.st_uid != me or linked or (opened and _open_to_others(status)):
                    shutil.rmtree(entry.path) if is_folder else os.unlink(entry.path)
                elif is_folder:
                    _rid(Path(entry.path), opened=opened)
            except FileNotFoundError:  # another process of the user's removed it
                continue
            except OSError as fault:
                raise NotOwn(f"{entry.path} is not the user's own ({fault.strerror})") from None
