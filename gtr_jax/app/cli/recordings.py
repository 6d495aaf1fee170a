"""Recordings as the commands read them: their options, and what the reader is told of what was left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gtr_jax.errors import InputError

if TYPE_CHECKING:
    from gtr_jax.recordings.recording import Recording

MOST_STORED = 1000  # places that are left out of a recording, in the settings of an answer

_columns = click.option(
    "--columns",
    metavar="MAP",
    multiple=True,
    help="Columns under other names or in other units: 'T_base=data_0[gf],T_tip=data_2[gf],time=Time[s]', "
    "raw counts with scale and offset: 'T_base=raw_0*0.00981-1.2[N]', or a mapping file (.toml), as gtr "
    "inspect writes it. Give one for all recordings, or one for each.",
)
_keep_glitches = click.option(
    "--keep-glitches",
    is_flag=True,
    help="Keep glitches: lone samples that a cell cannot have seen, which are masked unless asked for.",
)
_drop = click.option(
    "--drop",
    metavar="FROM:TO",
    multiple=True,
    help="Leave out a stretch of time: '12.5 s:13 s', '118:' to the end. Repeatable.",
)


def recording_options(command: Callable) -> Callable:
    """--columns, --keep-glitches and --drop, for parameters of these names."""
    return _columns(_keep_glitches(_drop(command)))


def mapping_of_each(paths: Sequence[Path], columns: Sequence[str]) -> list[str | None]:
    """The value of --columns for each recording, or None.

    Raises:
        InputError: there are several mappings, but not one for each recording.
    """
    if len(columns) not in (0, 1, len(paths)):
        raise InputError(
            f"--columns: given {len(columns)} times for {len(paths)} recording{'s'[: len(paths) - 1]}; give "
            "it once for all, or once for each in their order"
        )
    given: list[str | None] = list(columns) or [None]
    return given * len(paths) if len(given) == 1 else given


def read_recordings(
    paths: Sequence[Path],
    tendons: Sequence[Sequence[str]],
    *,
    columns: Sequence[str],
    keep_glitches: bool,
    drop: Sequence[str],
    need_tip: bool = True,
    measured: bool = False,
    most: int | None = None,
    space: bool = False,
    markers: Sequence[Sequence[str]] = (),
) -> list[Recording]:
    """Read recordings, and say on stderr what was left out of each.

    Args:
        paths: the files.
        tendons: names of the tendons of each, as `read_recording` takes them.
        columns, keep_glitches, drop: values of the options.
        need_tip: whether a file without a tip tension is refused.
        measured: whether one without is a recording nonetheless, as of `read_recording`.
        most: samples that each is thinned to; all of them unless given.
        space: whether what only robots in space have is looked for, as of `read_recording`.
        markers: names of the markers whose places are looked for in each; in none unless given.

    Raises:
        InputError: there are several mappings, but not one for each recording; a file is refused; or glitches
            are kept where none are looked for.
    """
    from gtr_jax.recordings.cleaning.masking import masked_says
    from gtr_jax.recordings.recording import read_recording, seeks_glitches
    from gtr_jax.recordings.thinning import thinned, thinned_says

    recordings = []
    points = markers or [()] * len(paths)
    each = zip(paths, mapping_of_each(paths, columns), tendons, points, strict=True)
    for path, mapping, names, placed in each:
        recording = read_recording(
            path,
            mapping,
            need_tip=need_tip,
            measured=measured,
            tendons=names,
            keep_glitches=keep_glitches,
            drop=drop,
            space=space,
            markers=placed,
        )
        recording = recording if most is None else thinned(recording, most)
        for said in (masked_says(recording.masked), thinned_says(recording), *recording.notes):
            if said:
                click.echo(f"warning: {path}: {said}", err=True)
        recordings.append(recording)
    if keep_glitches and not any(seeks_glitches(r.quantities, measured=measured) for r in recordings):
        where = ", ".join(str(path) for path in paths)
        raise InputError(
            f"--keep-glitches: has no effect on {where}, in which no glitches are looked for; leave it out"
        )
    return recordings


def mapping_files(columns: Sequence[str]) -> dict[str, Path]:
    """The mapping files among the values of --columns, by the role that a run folder records them under."""
    from gtr_jax.recordings.columns import is_file

    files = [Path(text) for text in columns if is_file(text)]
    return {f"columns {i + 1}": path for i, path in enumerate(files)}


def left_out(recordings: Sequence[Recording]) -> dict[str, Any]:
    """What was left out of recordings, for the settings of an answer; empty if nothing was."""
    from gtr_jax.recordings.cleaning.masking import masked_says
    from gtr_jax.recordings.thinning import thinned_says

    said = {
        str(r.path): {
            "says": "; ".join(filter(None, [masked_says(r.masked), thinned_says(r), *r.notes])),
            "masked": [m._asdict() for m in r.masked[:MOST_STORED]],
        }
        for r in recordings
        if r.masked or r.thinned_from or r.notes
    }
    return {"left_out": said} if said else {}
