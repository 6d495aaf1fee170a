"""`gtr fit`: parameters from a recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gtr_jax.errors import InputError

from .options import Quantity, columns_option, output_option, robot_argument

if TYPE_CHECKING:
    from gtr_jax.config import RobotConfig
    from gtr_jax.recording import Recording
    from gtr_jax.report import FitAnswer


@click.command()
@robot_argument
@click.argument("recordings", nargs=-1, required=True, metavar="REC.csv", type=click.Path(path_type=Path))
@click.option(
    "--free",
    metavar="NAMES",
    help="Parameters to fit, by short name or key in the robot file.  [default: mu,E; mu alone if rigid]",
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
@columns_option
@output_option
def fit(
    robot: Path,
    recordings: Sequence[Path],
    free: str | None,
    noise: float | None,
    noise_base: float | None,
    columns: str | None,
    output: Path,
) -> int:
    """Fit ROBOT.toml, which has one tendon, to a recording of base and tip tension, starting from the values
    in the file.
    """
    from gtr_jax.config import load_config
    from gtr_jax.recording import read_recording

    from .cache import enable_cache
    from .progress import Progress
    from .run_folder import RunFolder

    if len(recordings) > 1:
        raise InputError(f"{recordings[1]}: this version fits one recording; run gtr fit for each")
    config = load_config(robot)
    names = None if free is None else free_names(free)
    recording = read_recording(recordings[0], columns, tendons=config.tendon_names)
    folder = RunFolder(output, {"robot": robot, "recording": recordings[0]})
    enable_cache()
    with Progress() as progress:
        result = solve(config, recording, names, noise=noise, noise_base=noise_base, progress=progress)
        progress("drawing")
        with folder.write() as part:
            write_answer(part, result, recording, config, folder.settings())
    for line in summary(result):
        click.echo(line)
    click.echo(f"report: {output / 'report.html'}")
    return 0 if result.converged else 1


def free_names(free: str) -> tuple[str, ...]:
    """The parameters to fit, from the names with commas between."""
    names = tuple(name.strip() for name in free.split(",") if name.strip())
    if not names:
        raise InputError("--free: names no parameter; give for example --free mu,E")
    return names


def solve(
    config: RobotConfig,
    recording: Recording,
    free: tuple[str, ...] | None,
    *,
    noise: float | None = None,
    noise_base: float | None = None,
    progress: Any,
) -> FitAnswer:
    """Fit, reporting progress."""
    import calibrate

    for name, value in (("--noise", noise), ("--noise-base", noise_base)):
        if value is not None and (value < 0 or (value == 0 and name == "--noise")):
            raise InputError(f"{name}: a standard deviation is positive, this is {value:g} N")
    return calibrate.fit(
        config,
        recording,
        free=free,
        noise_N=noise,
        noise_base_N=noise_base,
        profiled=True,
        progress=progress,
    )


def summary(result: FitAnswer) -> list[str]:
    """The estimates, then the verdict, as lines for the terminal."""
    from gtr_jax.report.fit import quantity

    lines = []
    for e in result.estimates:
        line = f"{e.name} = {quantity(e.value, e.unit)}"
        if e.lower95 is not None:
            line += f", 95 % interval {quantity(e.lower95, e.unit)} to {quantity(e.upper95, e.unit)}"
        lines.append(line + (f" ({e.note})" if e.note else ""))
    return [*lines, *(f"warning: {text}" for text in result.warnings), result.verdict]


def write_answer(
    folder: Path, result: FitAnswer, recording: Recording, config: RobotConfig, settings: dict[str, Any]
) -> None:
    """Write all that a fit leaves into a folder."""
    from gtr_jax.config import dump_config
    from gtr_jax.recording import write_recording
    from gtr_jax.report import fit_report, render

    from .run_folder import write_json

    dump_config(config, folder / "robot.toml")
    if result.config is not None:
        dump_config(result.config, folder / "fitted.toml")
    columns = {
        "time": recording.time,
        "T_base": recording.T_base,
        "T_tip": recording.T_tip,
        "trial": recording.trial,
        "T_base_fitted_N": result.T_base,
        "T_tip_fitted_N": result.T_tip,
        "residual_N": result.residual,
        "phase": result.phases,
    }
    write_recording(folder / "fit.csv", {name: v for name, v in columns.items() if v is not None})
    data = result.to_json()
    write_json(folder / "fit.json", {**data, "settings": {**data["settings"], **settings}})
    report = fit_report(result, recording, config.name)
    for figure in report.figures:
        (folder / f"{figure.name}.png").write_bytes(figure.image)
    page = render(report, settings, (folder / "robot.toml").read_text(encoding="utf-8"))
    (folder / "report.html").write_text(page, encoding="utf-8")
