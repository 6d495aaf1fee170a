"""The peers' environments: one each, made from its pins when missing, in a folder that git ignores."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FOLDER = ROOT / ".venv-peers"


class PeerError(Exception):
    """A peer that cannot be installed or run; the message is one line."""


def _last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "no message"


def python_of(peer: str) -> Path:
    """The interpreter of a peer's environment, made first if it is missing or its pins have changed.

    Raises PeerError where the package index does not give it.
    """
    pins = HERE / f"requirements-{peer}.txt"
    where = FOLDER / peer
    python = where / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    installed = where / "installed.txt"  # written last: without it the environment is half made
    if python.exists() and installed.exists() and installed.read_text() == pins.read_text():
        return python
    shutil.rmtree(where, ignore_errors=True)
    for command in (
        [sys.executable, "-P", "-m", "venv", str(where)],
        [
            str(python),
            "-P",
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            "-r",
            str(pins),
        ],
    ):
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise PeerError(f"{peer}: cannot be installed: {_last_line(done.stderr)}")
    installed.write_text(pins.read_text())
    return python


def run(module: str, python: Path, *, quick: bool, timeout_s: float = 3600.0) -> str:
    """Run `benchmarks.peers.MODULE` in an environment; what it prints last.

    Raises PeerError where it fails.
    """
    with tempfile.TemporaryDirectory() as empty:
        environment = os.environ | {
            "PYTHONPATH": str(ROOT),
            "JAX_ENABLE_X64": "1",
            "JAX_PLATFORMS": "cpu",
            "JAX_ENABLE_COMPILATION_CACHE": "false",
            "NUMBA_CACHE_DIR": empty,  # so that the cold time is a cold one
        }
        try:
            done = subprocess.run(
                [str(python), "-P", "-m", f"benchmarks.peers.{module}", *["--quick"] * quick],
                capture_output=True,
                text=True,
                cwd=ROOT,
                env=environment,
                timeout=timeout_s,
            )
        except subprocess.TimeoutExpired:
            raise PeerError(f"{module}: not done after {timeout_s:g} s") from None
    if done.returncode:
        raise PeerError(f"{module}: exit {done.returncode}: {_last_line(done.stderr)}")
    return _last_line(done.stdout)
