"""`gtr diagnose`: which physics a model leaves out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gtr_jax.errors import InputError

from .fit import inputs
from .options import (
    channels_option,
    check_noise,
    figures_option,
    files_argument,
    noise_base_option,
    noise_option,
    output_option,
)
from .recordings import left_out, mapping_files, read_recordings, recording_options

if TYPE_CHECKING:
    from calibrate import Diagnosis
    from gtr_jax.config.config import RobotConfig
    from gtr_jax.recordings.recording import Recording


@click.command()
@files_argument
@channels_option
@noise_option
@noise_base_option
@click.option(
    "--next",
    "experiment",
    is_flag=True,
    default=None,
    help="Propose the experiment that would tell the rivals apart even where one is named.",
)
@click.option(
    "--settles",
    metavar="FOLDER",
    type=click.Path(path_type=Path),
    help="Run folder of an earlier diagnosis that left rivals: say what the recordings now settle of them.",
)
@click.option(
    "--exclude",
    metavar="FROM:TO",
    multiple=True,
    help="Simulate a stretch of time, but do not compare it: '9 s:9.6 s', '118:' to the end. Repeatable.",
)
@click.option(
    "--without",
    metavar="TERM,...",
    default="",
    help="Leave physics terms out of what is tried: presliding,local-friction. `gtr terms` lists them.",
)
@recording_options
@figures_option
@output_option
def diagnose(
    files: Sequence[Path],
    channels: str | None,
    noise: float | None,
    noise_base: float | None,
    experiment: bool | None,
    settles: Path | None,
    exclude: Sequence[str],
    without: str,
    columns: Sequence[str],
    keep_glitches: bool,
    drop: Sequence[str],
    figures: Sequence[str],
    output: Path,
    force: bool,
) -> int:
    """Find which physics in a robot's recordings its model leaves out: where they differ, what is missing,
    whether a fit with it is better on samples it has not seen, and what to measure next. The robot may leave
    the plane and have several tendons, driven by tension or by displacement. Recordings without T_tip_N are
    explained by what they have most of: places (of the tip, markers, displacements) or angles.
    """
    from calibrate.diagnosis.answer.earlier import earlier_set, settle
    from gtr_jax.cache import enable_cache
    from gtr_jax.config.config import load_config
    from gtr_jax.recordings.cleaning.masking import times_of
    from gtr_jax.recordings.thinning import MOST

    from .progress import Progress, kept
    from .run_folder import RunFolder

    given = inputs(files)
    if len(given.robots) > 1:
        raise InputError(f"{given.robots[1]}: a diagnosis is of one robot; run it once for each")
    config = load_config(given.robots[0])
    earlier = None if settles is None else earlier_set(settles)
    recordings = read_recordings(
        given.recordings,
        [config.tendon_names] * len(given.recordings),
        space=True,
        markers=[[marker.name for marker in config.markers]] * len(given.recordings),
        columns=columns,
        keep_glitches=keep_glitches,
        drop=drop,
        most=MOST,
        measured=True,
    )
    paths = {"robot": given.robots[0]}
    paths |= {f"recording {i + 1}": path for i, path in enumerate(given.recordings)}
    paths |= mapping_files(columns)
    folder = RunFolder(output, paths, force=force)
    enable_cache()
    with folder.alone(), kept(), Progress() as progress:
        if folder.steps.exists():
            click.echo("resuming the interrupted run", err=True)
        answer = solve(
            config,
            recordings,
            channels=channels,
            noise=noise,
            noise_base=noise_base,
            experiment=experiment,
            exclude=[times_of(text, f"--exclude '{text}'") for text in exclude],
            without=[name.strip() for name in without.split(",") if name.strip()],
            steps=folder.steps,
            progress=progress,
        )
        if earlier is not None:
            answer = dataclasses.replace(answer, settles=settle(str(settles), earlier, answer))
        progress("drawing")
        with folder.write() as part:
            settings = folder.settings() | left_out(recordings)
            write_answer(part, answer, config, settings, figures=figures)
        folder.steps.unlink(missing_ok=True)
    for line in summary(answer):
        click.echo(line)
    click.echo(f"report: {output / 'report.html'}")
    if experiment and answer.experiment is None:
        click.echo("next: no rivals remain")
    return 0 if answer.converged and answer.verdict != "bad-data" else 1


def solve(
    config: RobotConfig,
    recordings: Sequence[Recording],
    *,
    noise: float | None = None,
    noise_base: float | None = None,
    progress: Any,
    **options: Any,
) -> Diagnosis:
    """Diagnose, reporting progress."""
    import calibrate

    check_noise(noise, noise_base)
    return calibrate.diagnose(
        config, recordings, noise_N=noise, noise_base_N=noise_base, progress=progress, **options
    )


def summary(answer: Diagnosis) -> list[str]:
    """The verdict, where, the robot files, and what to measure next, as lines for the terminal."""
    lines = [f"{answer.verdict}: {answer.says}"]
    if answer.settles is not None:
        lines.append(f"settles: {answer.settles.says}")
    lines += [f"where: {w.says}" for w in answer.where[:3]]
    lines += [f"when: {e.says}" for e in answer.episodes[:3]]
    if answer.files and answer.files[0].note:
        lines.append(f"{answer.files[0].name}: {answer.files[0].note}")
    if answer.experiment is not None:
        lines.append(f"next: {answer.experiment.says}")
    return [*lines, *(f"warning: {text}" for text in answer.warnings)]


def write_answer(
    folder: Path,
    answer: Diagnosis,
    config: RobotConfig,
    settings: dict[str, Any],
    *,
    figures: Sequence[str] = (),
) -> None:
    """Write all that a diagnosis leaves into a folder."""
    from calibrate.diagnosis.answer.loop import loop_columns
    from calibrate.report.diagnosis import diagnosis_report
    from gtr_jax.config.config import config_text, dump_config
    from gtr_jax.recordings.recording import write_recording

    from .run_folder import write_json, write_report

    dump_config(config, folder / "robot.toml")
    for file in answer.files:
        dump_config(file.config, folder / file.name, note=file.note)
    for loop in answer.loops:
        ending = f"-{loop.name}" if len(answer.loops) > 1 else ""
        write_recording(folder / f"diagnosis{ending}.csv", loop_columns(loop))
    if answer.experiment is not None:
        write_recording(folder / "next-experiment.csv", _to_drive(answer))
    data = answer.to_json()
    write_json(folder / "diagnosis.json", {**data, "settings": {**data["settings"], **settings}})
    report = diagnosis_report(answer, config.name)
    write_report(folder, report, settings, config_text(answer.config or config), figures=figures)


def _to_drive(answer: Diagnosis) -> dict[str, Any]:
    """The columns of `next-experiment.csv`: what drives each tendon, or the weights to hang on the cells."""
    e = answer.experiment
    assert e is not None
    if e.T_tip is not None:
        return {"time": e.time, "weight_base_N": e.T_base, "weight_tip_N": e.T_tip}
    pulls = answer.loops[0].pulls
    each = [e.T_base] if len(pulls) == 1 else list(e.T_base.T)
    names = ["displacement_m" if pull.by_displacement else "T_base_N" for pull in pulls]
    return {"time": e.time} | {
        f"{name}.{pull.tendon}".rstrip("."): own for name, pull, own in zip(names, pulls, each, strict=True)
    }
