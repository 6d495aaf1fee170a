"""`gtr inspect`: what a recording says by itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gtr_jax.errors import InputError

from .options import InputFile, columns_option, output_option

if TYPE_CHECKING:
    from gtr_jax.files.guessing import Guess
    from gtr_jax.files.recording import Recording
    from gtr_jax.inspection.inspection import Inspection
    from gtr_jax.report.page import Table


@click.command()
@click.argument("recordings", nargs=-1, required=True, metavar="REC.csv ...", type=InputFile(".csv"))
@columns_option
@output_option
def inspect(recordings: Sequence[Path], columns: str | None, output: Path, force: bool) -> int:
    """Look at recordings before anything is fitted to them: sampling, noise, glitches, zeros, stuck cells,
    the delay between the cells, cycles, rates, apparent friction, and what can be learnt from them.

    Columns and units that no header names are guessed, and written as columns.toml, which every command
    takes as --columns.
    """
    from gtr_jax.files.recording import read_recording
    from gtr_jax.files.table import read_table
    from gtr_jax.inspection.inspection import inspect as inspected

    from .run_folder import RunFolder

    paths = {
        f"recording {i + 1}" if len(recordings) > 1 else "recording": p for i, p in enumerate(recordings)
    }
    folder = RunFolder(output, paths, force=force, with_jax=False)
    raise NotImplementedError(read_recording, read_table, inspected)
