"""`gtr inspect`: what a recording says by itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from .options import InputFile, output_option
from .recordings import mapping_of_each, recording_options

if TYPE_CHECKING:
    from gtr_jax.inspection.inspection import Inspection
    from gtr_jax.inspection.mapping import Mapping
    from gtr_jax.recordings.recording import Recording


class Inspected(NamedTuple):
    """A recording, what its columns were taken for, what it says, and what it is called."""

    recording: Recording
    mapping: Mapping
    found: Inspection
    name: str


@click.command()
@click.argument("recordings", nargs=-1, required=True, metavar="REC.csv ...", type=InputFile(".csv"))
@recording_options
@output_option
def inspect(
    recordings: Sequence[Path],
    columns: Sequence[str],
    keep_glitches: bool,
    drop: Sequence[str],
    output: Path,
    force: bool,
) -> int:
    """Look at recordings before anything is fitted to them: sampling, noise, glitches, zeros, stuck cells,
    delay between the cells, cycles, rates, apparent friction, and what can be learnt from them.

    Columns and units that the header does not give are guessed. The run folder holds the mapping as
    columns.toml, which every command takes as --columns, and the recording in SI without glitches as
    recording.csv; with several recordings, both carry their names.
    """
    from .run_folder import RunFolder

    paths = {f"recording {i}" if len(recordings) > 1 else "recording": p for i, p in enumerate(recordings, 1)}
    folder = RunFolder(output, paths, force=force, with_jax=False)
    names = _names(recordings)
    inspected = [
        _inspected(path, mapping, name, keep_glitches=keep_glitches, drop=drop)
        for path, mapping, name in zip(recordings, mapping_of_each(recordings, columns), names, strict=True)
    ]
    with folder.write() as part:
        _write(part, inspected, folder.settings(), keep_glitches=keep_glitches, drop=drop)
    for line in _summary(inspected, output):
        click.echo(line)
    click.echo(f"report: {output / 'report.html'}")
    return 0


def _names(paths: Sequence[Path]) -> list[str]:
    """What the recordings are called: the stems of their files, numbered where they are alike."""
    stems = [path.stem for path in paths]
    return [
        stem if stems.count(stem) == 1 else f"{stem}-{stems[: i + 1].count(stem)}"
        for i, stem in enumerate(stems)
    ]


def _inspected(
    path: Path, said: str | None, name: str, *, keep_glitches: bool, drop: Sequence[str]
) -> Inspected:
    from gtr_jax.inspection.inspection import inspect as inspection_of
    from gtr_jax.inspection.mapping import mapping as mapping_of
    from gtr_jax.recordings.columns import Columns, read_columns
    from gtr_jax.recordings.formats.table import read_table
    from gtr_jax.recordings.guessing import guess
    from gtr_jax.recordings.recording import read_recording

    table = read_table(path)
    own = None if said is None else read_columns(said, f"{path}: ")
    mapping = mapping_of(table, guess(table), own)
    whole = Columns(
        place="--columns" if own is None else own.place,
        entries=tuple(mapping.columns.items()),
        keep_glitches=keep_glitches or (own is not None and own.keep_glitches),
        drop=(*(() if own is None else own.drop), *drop),
    )
    recording = read_recording(table, whole, doubtful=True)
    for said in recording.notes:
        click.echo(f"warning: {path}: {said}", err=True)
    return Inspected(recording, mapping, inspection_of(recording), name)


def _write(
    folder: Path,
    inspected: Sequence[Inspected],
    settings: dict,
    *,
    keep_glitches: bool,
    drop: Sequence[str],
) -> None:
    """Write all that an inspection leaves into a folder."""
    from gtr_jax.inspection.report.inspection import inspection_report
    from gtr_jax.recordings.columns import write_columns
    from gtr_jax.recordings.recording import write_recording

    from .run_folder import write_json, write_report

    answers = {}
    for own in inspected:
        ending = f"-{own.name}" if len(inspected) > 1 else ""
        note = "\n".join(["Written by gtr inspect.", *own.mapping.doubts])
        write_columns(
            folder / f"columns{ending}.toml",
            own.mapping.columns,
            keep_glitches=keep_glitches,
            drop=drop,
            note=note,
        )
        write_recording(folder / f"recording{ending}.csv", own.recording)
        columns = [
            {"quantity": t.quantity, "header": t.header, "unit": t.unit, "why": t.why, "sure": t.sure}
            for t in own.mapping.taken
        ]
        answers[own.name] = {**own.found.to_json(), "columns": columns, "doubts": list(own.mapping.doubts)}
    (first, *more) = answers.values()
    data = {"recordings": answers} if more else first
    write_json(folder / "inspection.json", {**data, "settings": settings})
    report = inspection_report(
        [own.found for own in inspected],
        [own.recording for own in inspected],
        names=[own.name for own in inspected],
        mappings=[own.mapping for own in inspected],
    )
    write_report(folder, report, settings, None)


def _summary(inspected: Sequence[Inspected], output: Path) -> Iterator[str]:
    """What the terminal shows: the whole first, then problems and notes with their remedies."""
    several = len(inspected) > 1
    for own in inspected:
        file = output / (f"columns-{own.name}.toml" if several else "columns.toml")
        guessed = f" Columns or units are guessed: confirm them in {file}." if own.mapping.doubts else ""
        yield (f"{own.name}: " if several else "") + own.found.says + guessed
        yield from (f"confirm: {doubt}" for doubt in own.mapping.doubts)
        for finding in own.found.findings:
            yield f"{finding.severity}: {finding.says} {finding.remedy}".rstrip()
        missing = [need.question for need in own.found.needs if not need.there]
        if missing:
            yield f"cannot tell: {'; '.join(missing)}"
