"""The persistent compilation cache: a second run takes its compiled programs from the disk.

Programs that are read from it are run. So it lies in a folder that is the user's own and that nobody else can
change (`owned`); that is all that guards the files of JAX's cache, which JAX loads. Our own programs are
sealed besides (`sealed`).
"""

from __future__ import annotations

import os
import shutil
import warnings
from importlib.metadata import version
from pathlib import Path

from .errors import InputWarning
from .owned import NotOwn, beside_temporary_files, own_folder

VARIABLE = "GTR_JAX_CACHE"


def cache_folder() -> Path | None:
    """Where compiled programs are to be kept: per user and per jaxlib; None if the user switched it off.

    GTR_JAX_CACHE is `off`, or a folder to use in place of the user's cache folder.
    """
    wanted = os.environ.get(VARIABLE, "")
    if wanted.lower() == "off":
        return None
    return (Path(wanted) if wanted else _of_the_user()) / _of_this_jaxlib()


def enable_cache() -> Path | None:
    """Keep compiled programs on the disk, however small, for later sessions. The command `gtr` does so by
    itself; in Python call it once, after the import.

    The folder is that of the command: one per user and per jaxlib, or what the environment variable
    GTR_JAX_CACHE says, a folder or `off`. Programs in it are run, so it must be the user's own, in folders
    that nobody else can change; it is closed to others. Otherwise another is used, and a warning says so.

    Returns:
        The folder, or None: switched off, or nowhere to write (the session is then slower, not wrong).
    """
    wanted = cache_folder()
    if wanted is None:
        return None
    folder = _taken(wanted)
    if folder is None or not os.access(folder, os.W_OK):
        return None
    import jax
    from jax.experimental.compilation_cache import compilation_cache

    from . import stored

    shutil.rmtree(folder / "native", ignore_errors=True)  # of versions that did not seal what they kept
    stored.enable(folder)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    compilation_cache.reset_cache()  # JAX looks for the folder once, when it first compiles
    return folder


def _of_the_user() -> Path:
    from platformdirs import user_cache_path

    return user_cache_path("gtr-jax", appauthor=False)


def _of_this_jaxlib() -> str:
    return f"jaxlib-{version('jaxlib')}"


def _taken(wanted: Path) -> Path | None:
    """The wanted folder if it is the user's own, else another that is; None where none can be written."""
    why, others = (
        "",
        (wanted, _of_the_user() / _of_this_jaxlib(), beside_temporary_files() / _of_this_jaxlib()),
    )
    taken = None
    for folder in dict.fromkeys(others):
        try:
            taken = own_folder(folder)
            break
        except NotOwn as fault:
            why = why or str(fault)
        except OSError:
            if not why:  # the folder that was wanted cannot be written
                return None
    if why:
        instead = f"are kept in {taken} instead" if taken else "are not kept"
        warnings.warn(
            f"{wanted}: {why}, and programs kept there are run: compiled programs {instead}; "
            f"name a folder of your own in {VARIABLE}",
            InputWarning,
            stacklevel=3,
        )
    return taken
