"""`gtr diagnose`: which physics a model leaves out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gtr_jax.errors import InputError

from .fit import inputs
from .options import Quantity, columns_option, output_option

if TYPE_CHECKING:
    from gtr_jax.config import RobotConfig


@click.command()
@click.argument(
    "files", nargs=-1, required=True, metavar="ROBOT.toml REC.csv ...", type=click.Path(path_type=Path)
)
@click.option(
    "--channels",
    metavar="NAMES",
    help="What to compare beside T_tip, where a recording has it: some of tip_x, tip_y, tip_angle, "
    "displacement; '' for nothing.  [default: all]",
)
@click.option(
    "--noise",
    type=Quantity("N", "SD"),
    help="Standard deviation of the recorded tip tension.  [default: estimated from the recording]",
)
@click.option(
    "--noise-base",
    type=Quantity("N", "SD"),
    help="The same of the base tension; 0 takes it as exact.  [default: estimated from the recording]",
)
@click.option(
    "--next",
    "experiment",
    is_flag=True,
    default=None,
    help="Propose the experiment that would tell the rivals apart even where one is named.",
)
@columns_option
@output_option
def diagnose(
    files: Sequence[Path],
    channels: str | None,
    noise: float | None,
    noise_base: float | None,
    experiment: bool | None,
    columns: str | None,
    output: Path,
) -> int:
    """Tell which physics a robot's model leaves out of its recordings: where they differ, what is missing,
    whether a fit with it is better on samples it has not seen, and what to measure next.
    """
    from gtr_jax.config import load_config
    from gtr_jax.recording import read_recording

    from .cache import enable_cache
    from .progress import Progress
    from .run_folder import RunFolder

    given = inputs(files)
    if len(given.robots) > 1:
        raise InputError(f"{given.robots[1]}: a diagnosis is of one robot; run it once for each")
    config = load_config(given.robots[0])
    recordings = [read_recording(path, columns, tendons=config.tendon_names) for path in given.recordings]
    paths = {"robot": given.robots[0]}
    paths |= {f"recording {i + 1}": path for i, path in enumerate(given.recordings)}
    folder = RunFolder(output, paths)
    enable_cache()
    with Progress() as progress:
        answer = solve(
            config,
            recordings,
            channels=channels,
            noise=noise,
            noise_base=noise_base,
            experiment=experiment,
            progress=progress,
        )
        progress("drawing")
        with folder.write() as part:
            write_answer(part, answer, config, folder.settings())
    for line in summary(answer):
        click.echo(line)
    click.echo(f"report: {output / 'report.html'}")
    return 0 if answer.converged else 1


def solve(config: RobotConfig, recordings: Sequence[Any], *, progress: Any, **options: Any) -> Any:
    """Diagnose, reporting progress."""
    import calibrate

    for name in ("noise", "noise_base"):
        value = options.pop(name, None)
        if value is not None and (value < 0 or (value == 0 and name == "noise")):
            raise InputError(
                f"--{name.replace('_', '-')}: a standard deviation is positive; this is {value:g} N"
            )
        options[f"{name}_N"] = value
    channels = options.pop("channels", None)
    if channels is not None:
        channels = tuple(name.strip() for name in channels.split(",") if name.strip())
    return calibrate.diagnose(config, recordings, channels=channels, progress=progress, **options)


def summary(answer: Any) -> list[str]:
    """The verdict, where, and what to measure next, as lines for the terminal."""
    lines = [f"{answer.verdict}: {answer.says}"]
    lines += [f"where: {w.says}" for w in answer.where[:3]]
    if answer.experiment is not None:
        lines.append(f"next: {answer.experiment.says}")
    return [*lines, *(f"warning: {text}" for text in answer.warnings)]


def write_answer(folder: Path, answer: Any, config: RobotConfig, settings: dict[str, Any]) -> None:
    """Write all that a diagnosis leaves into a folder."""
    from gtr_jax.config import config_text, dump_config
    from gtr_jax.recording import write_recording
    from gtr_jax.report import diagnosis_report, render

    from .run_folder import write_json

    dump_config(config, folder / "robot.toml")
    if answer.config is not None:
        dump_config(answer.config, folder / "diagnosed.toml")
    for loop in answer.loops:
        columns = {"time": loop.time, "T_base": loop.T_base, "T_tip": loop.recorded[0]}
        columns |= {"T_tip_before_N": loop.before[0], "T_tip_after_N": loop.after[0], "phase": loop.phases}
        ending = f"-{loop.name}" if len(answer.loops) > 1 else ""
        write_recording(
            folder / f"diagnosis{ending}.csv", {k: v for k, v in columns.items() if v is not None}
        )
    if answer.experiment is not None:
        e = answer.experiment
        write_recording(folder / "next-experiment.csv", {"time": e.time, "T_base": e.T_base})
    data = answer.to_json()
    write_json(folder / "diagnosis.json", {**data, "settings": {**data["settings"], **settings}})
    report = diagnosis_report(answer, config.name)
    for figure in report.figures:
        (folder / f"{figure.name}.png").write_bytes(figure.image)
    page = render(report, settings, config_text(answer.config or config))
    (folder / "report.html").write_text(page, encoding="utf-8")
