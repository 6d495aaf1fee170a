"""Files of programs, which whoever reads them runs: sealed with a secret key of the user's, so that nobody
else's is run.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import hmac
import os
import secrets
from pathlib import Path

from .leftovers import replaced_atomically
from .owned import is_own, private_place

KEY = "key"  # name of the file
LENGTH, SEAL = 32, 32  # bytes of the key, and of a seal


def read(path: Path) -> bytes | None:
    """What a sealed file holds; None if there is none, or none with this user's seal."""
    own = key()
    if own is None:
        return None
    try:
        whole = path.read_bytes() if path.is_file() else b""
    except OSError:
        return None
    seal, contents = whole[:SEAL], whole[SEAL:]
    return contents if hmac.compare_digest(seal, _seal(own, path, contents)) else None


def write(path: Path, contents: bytes) -> None:
    """Write a sealed file, whole or not at all; where it cannot be written there is none."""
    own = key()
    if own is None:
        return
    with contextlib.suppress(OSError), replaced_atomically(path) as temporary:
        temporary.write_bytes(_seal(own, path, contents) + contents)


def _seal(own: bytes, path: Path, contents: bytes) -> bytes:
    """Of a file of this name: one that takes another's place has not its seal."""
    whole = hashlib.blake2b(f"{path.parent.name}/{path.name}".encode() + b"\0", key=own, digest_size=SEAL)
    whole.update(contents)
    return whole.digest()


@functools.cache
def key() -> bytes | None:
    """The user's key, made when it is first needed; None where no file can be kept from others."""
    folder = private_place()
    return None if folder is None else key_in(folder)


def key_in(folder: Path) -> bytes | None:
    """The key in a folder of the user's own."""
    path = folder / KEY
    for _ in range(2):
        found = _read_key(path)
        if found is not None:
            return found
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)  # cut short, or no longer a secret
            mine = folder / f".{KEY}.{secrets.token_hex(8)}"
            handle = os.open(mine, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(handle, "wb") as file:
                file.write(secrets.token_bytes(LENGTH))
            try:
                os.link(mine, path)  # of processes that do so at the same time the first one's key stays
            except FileExistsError:
                pass
            except OSError:  # a disk without links
                os.replace(mine, path)
            mine.unlink(missing_ok=True)
    return _read_key(path)


def _read_key(path: Path) -> bytes | None:
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0))
    except OSError:
        return None
    with os.fdopen(handle, "rb") as file:
        status, held = os.fstat(file.fileno()), file.read(LENGTH + 1)
    open_to_others = os.name == "posix" and status.st_mode & 0o077
    return held if is_own(status) and not open_to_others and len(held) == LENGTH else None
