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
    """Switch the cache on, for every program however small. Must run before anything is compiled.

    Returns:
        The folder, or None: switched off, or nowhere to write (the run is then slower, not wrong).
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

    from gtr_jax import stored
    from gtr_jax.terms import OWN

    if not OWN:  # those programs are told apart by our sources, and not by those of a user's terms
        stored.enable(folder)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return folder
