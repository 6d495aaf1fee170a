"""Compiled programs kept on disk, so that a later run of a command need not trace them again.

JAX's persistent cache saves compilation, but a program must be traced and lowered before it is looked up
there: 2.2 s of processor time for the derivatives of a load history. Reading the compiled program takes 0.3
s.
"""

from __future__ import annotations

import functools
import hashlib
import os
import pickle
import platform
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
from jax.core import Tracer
from jax.experimental import serialize_executable

# Packages whose versions determine a compiled program, besides the sources of this project.
VERSIONS = ("jax", "jaxlib", "equinox", "lineax", "optimistix", "numpy")
# JAX settings that determine it.
FLAGS = ("jax_enable_x64", "jax_numpy_dtype_promotion", "jax_numpy_rank_promotion")
# How many folders with programs of earlier sources or flags are kept besides the current one.
EARLIER = 2

_root: Path | None = None
# Whether our sources alone determine the programs.
_ours = True


def enable(folder: Path) -> None:
    """From now on keep programs in this folder. It must belong to the user: programs read from it are
    executed.
    """
    global _root
    _root = folder


def keep_none() -> None:
    """From now on neither keep nor read programs: they depend on sources of others, such as a user's terms,
    which do not tell them apart.
    """
    global _ours
    _ours = False


class Stored:
    """A function compiled as by `equinox.filter_jit`, whose programs are kept on disk once `enable` was
    called.

    Args:
        function: takes positional arguments, of which arrays are traced and everything else is static;
            returns a tuple of arrays.
    """

    def __init__(self, function: Callable[..., tuple[jax.Array, ...]]):
        functools.update_wrapper(self, function)
        self._function, self._jitted = function, eqx.filter_jit(function)
        self._programs: dict[str, Callable[..., Sequence[jax.Array]]] = {}
        self._lock = threading.Lock()

    def __call__(self, *args: Any) -> tuple[jax.Array, ...]:
        """The function's value."""
        arrays, rest = eqx.partition(args, eqx.is_array)
        leaves, tree = jax.tree_util.tree_flatten(arrays)
        traced = any(isinstance(leaf, Tracer) for leaf in leaves)
        if _root is None or not _ours or traced or jax.default_backend() != "cpu":
            return self._jitted(*args)
        shapes = [(leaf.shape, str(leaf.dtype)) for leaf in leaves]
        key = hashlib.sha256(
            repr((self._function.__qualname__, str(tree), repr(rest), shapes)).encode()
        ).hexdigest()
        with self._lock:
            if key not in self._programs:

                def flat(*leaves):
                    return self._function(*eqx.combine(jax.tree_util.tree_unflatten(tree, leaves), rest))

                around = _surroundings(self.__module__.partition(".")[0])
                # JAX's cache also tells programs apart by name. A program taken from it cannot be serialised
                # again, so this one gets a name that JAX's cache does not hold.
                flat.__name__ = f"{self._function.__name__}_{around}"
                path = _root / f"programs-{around}" / key
                self._programs[key] = _read(path, leaves) or _made(flat, leaves, path)
        return tuple(self._programs[key](*leaves))


def _read(path: Path, leaves: Sequence[Any]) -> Callable[..., Sequence[jax.Array]] | None:
    """The program in a file; None if there is none that can be read and run."""
    try:
        return _tried(path.read_bytes(), leaves)
    except Exception:  # of any kind: the program is then compiled again
        return None


def _tried(contents: bytes, leaves: Sequence[Any]) -> Callable[..., Sequence[jax.Array]]:
    """The program in these bytes, after a trial run."""
    program = serialize_executable.deserialize_and_load(*pickle.loads(contents))
    jax.block_until_ready(program(*leaves))
    return program


def _made(flat: Callable[..., Any], leaves: Sequence[Any], path: Path) -> Callable[..., Sequence[jax.Array]]:
    """The program compiled, and written to a file if that can be done."""
    program = jax.jit(flat).lower(*leaves).compile()
    try:
        contents = pickle.dumps(serialize_executable.serialize(program))
        _tried(contents, leaves)
        _make_room(path.parent)
        # Replaced atomically: another process may write the same file.
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(contents)
        os.replace(file.name, path)
    except Exception:  # of any kind: the program is then not kept
        return program
    return program


def _make_room(folder: Path) -> None:
    """Create the folder, and delete those of earlier sources except the latest few."""
    if folder.exists():
        return
    others = sorted(folder.parent.glob("programs-*"), key=lambda f: f.stat().st_mtime)
    for old in others[: max(len(others) - EARLIER, 0)]:
        for file in old.iterdir():
            file.unlink()
        old.rmdir()
    folder.mkdir(parents=True, exist_ok=True)


@functools.cache
def _surroundings(package: str) -> str:
    """Hash of all that determines what a package's functions compile to, besides their arguments: sources,
    versions, flags and processor.
    """
    whole = hashlib.sha256()
    for name in dict.fromkeys(("gtr_jax", package)):
        file = sys.modules[name].__file__
        assert file is not None
        folder = Path(file).parent
        for path in sorted(folder.rglob("*.py")):
            whole.update(str(path.relative_to(folder)).encode())
            whole.update(path.read_bytes())
    flags = os.environ.get("XLA_FLAGS", ""), [jax.config.values[name] for name in FLAGS]
    versions = [version(name) for name in VERSIONS]
    whole.update(repr((versions, sys.version, flags, platform.machine(), _processor())).encode())
    return whole.hexdigest()[:32]


def _processor() -> str:
    """The processor's features: a program compiled for one processor may not run on another."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() + platform.node()
    return next((line for line in lines if line.startswith(("flags", "Features"))), platform.node())
