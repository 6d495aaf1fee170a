"""The persistent compilation cache: a second run takes its compiled programs from the disk."""

from __future__ import annotations

import os
from importlib.metadata import version
from pathlib import Path

VARIABLE = "GTR_JAX_CACHE"


def cache_folder() -> Path | None:
    """Where compiled programs are kept: per user and per jaxlib; None if the user switched it off.

    GTR_JAX_CACHE is `off`, or a folder to use in place of the user's cache folder.
    """
    wanted = os.environ.get(VARIABLE, "")
    if wanted.lower() == "off":
        return None
    if wanted:
        root = Path(wanted)
    else:
        from platformdirs import user_cache_path

        root = user_cache_path("gtr-jax", appauthor=False)
    return root / f"jaxlib-{version('jaxlib')}"


def enable_cache() -> Path | None:
    """Keep compiled programs on the disk, however small, for later sessions. The command `gtr` does so by
    itself; in Python call it once, after the import.

    The folder is that of the command: one per user and per jaxlib, or what the environment variable
    GTR_JAX_CACHE says, a folder or `off`. Programs in it are executed, so nobody else may have write access.

    Returns:
        The folder, or None: switched off, or nowhere to write (the session is then slower, not wrong).
    """
    folder = cache_folder()
    if folder is None:
        return None
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    if not os.access(folder, os.W_OK):
        return None
    import jax
    from jax.experimental.compilation_cache import compilation_cache

    from . import stored

    stored.enable(folder)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    compilation_cache.reset_cache()  # JAX looks for the folder once, when it first compiles
    return folder
