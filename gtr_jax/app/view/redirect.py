"""A page of the user's own that leads to the live page: every user of a machine can read what a browser is
started with, which is then only the name of a file that they cannot read.
"""

from __future__ import annotations

import contextlib
import os
from html import escape
from pathlib import Path

from gtr_jax.leftovers import beside, clear
from gtr_jax.owned import private_place

PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>gtr view</title>
<meta name="referrer" content="no-referrer"><meta http-equiv="refresh" content="0; url={address}"></head>
<body><a href="{address}">The live page</a></body></html>
"""


class Redirect:
    """A file that leads to an address, and that only the user can read.

    Attributes:
        path: of the file; None where there is no folder of the user's own to put it in.
    """

    def __init__(self, address: str) -> None:
        self.path: Path | None = None
        place = private_place()
        if place is None:
            return
        clear(place)  # of commands that were killed
        path = beside(place / "view", "html")
        with contextlib.suppress(OSError):
            handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(PAGE.format(address=escape(address)))
            self.path = path

    def remove(self) -> None:
        """Remove the file, which is of no use once the browser has been there."""
        if self.path is not None:
            with contextlib.suppress(OSError):
                self.path.unlink(missing_ok=True)
