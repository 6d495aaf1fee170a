"""What a solver's process says: JSON on the last line of its output."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import Any


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None  # run from the source tree


def answer(run: Callable[[bool], dict[str, Any]], packages: tuple[str, ...]) -> None:
    """Run and print, with the versions of what ran."""
    found = run("--quick" in sys.argv)
    found["versions"] = {name: v for name in packages if (v := _version(name))}
    print(json.dumps(found))
