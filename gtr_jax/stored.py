"""Compiled programs kept on disk, so that a later run of a command need not trace them again.

JAX's persistent cache saves compilation, but a program must be traced and lowered before it is looked up
there: 2.2 s of processor time for the derivatives of a load history. Reading the compiled program takes 0.3
s.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import sys
import threading
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
from jax.core import Tracer
from jax.experimental import serialize_executable

from .kept import Kept

# Packages whose versions determine a compiled program, besides the sources of this project.
VERSIONS = ("jax", "jaxlib", "equinox", "lineax", "optimistix", "numpy")
# JAX settings that determine it.
COUNT = 8  # bytes before a program on disk, which say how many arrays it returns
FLAGS = ("jax_enable_x64", "jax_numpy_dtype_promotion", "jax_numpy_rank_promotion")
_root: Path | None = None
# Whether our sources alone determine the programs.
_ours = True


def enable(folder: Path) -> None:
    """From now on keep programs in this folder, which must be the user's own."""
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
                kept = Kept("programs", around, lambda: _root)
                self._programs[key] = _read(kept, key, leaves) or _made(flat, leaves, kept, key)
        return tuple(self._programs[key](*leaves))


def _read(kept: Kept, key: str, leaves: Sequence[Any]) -> Callable[..., Sequence[jax.Array]] | None:
    """The program that is kept; None if there is none that can be read and run."""
    try:
        contents = kept.read(key)
        return None if contents is None else _tried(contents, leaves)
    except Exception:  # of any kind: the program is then compiled again
        return None


def _tried(contents: bytes, leaves: Sequence[Any]) -> Callable[..., Sequence[jax.Array]]:
    """The program in these bytes, after a trial run. JAX unpickles it, so it must be one that this user has
    written.
    """
    count, held = int.from_bytes(contents[:COUNT], "little"), contents[COUNT:]
    given, answer = (jax.tree_util.tree_structure(tree) for tree in ((tuple(leaves), {}), (0,) * count))
    program = serialize_executable.deserialize_and_load(held, given, answer)
    jax.block_until_ready(program(*leaves))
    return program


def _made(
    flat: Callable[..., Any], leaves: Sequence[Any], kept: Kept, key: str
) -> Callable[..., Sequence[jax.Array]]:
    """The program compiled, and kept if that can be done."""
    program = jax.jit(flat).lower(*leaves).compile()
    try:
        held, _, answer = serialize_executable.serialize(program)
        contents = answer.num_leaves.to_bytes(COUNT, "little") + held  # of a tuple of arrays
        _tried(contents, leaves)
        kept.write(key, contents)
    except Exception:  # of any kind: the program is then not kept
        return program
    return program


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
