"""`gtr fit`: parameters from recordings."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from gtr_jax.errors import InputError
from gtr_jax.interruption import interruption

from .options import (
    STDIN,
    channels_option,
    check_noise,
    figures_option,
    files_argument,
    held_stdin,
    noise_base_option,
    noise_option,
    output_option,
)
from .recordings import left_out, mapping_files, read_recordings, recording_options

if TYPE_CHECKING:
    from calibrate import FitResult
    from gtr_jax.config.config import RobotConfig
    from gtr_jax.recordings.recording import Recording


class Inputs(NamedTuple):
    """What is fitted to what: the robot files, the recordings, and the robot of each recording by number."""

    robots: list[Path]
    recordings: list[Path]
    of: list[int]


@click.command()
@files_argument
@click.option(
    "--free",
    metavar="NAMES",
    help="Parameters to fit, by short name or key in the robot file.  "
    "[default: mu and what gives the stiffness, E, EI or stiffness_factor; mu alone if rigid; the mu of each "
    "of several tendons]",
)
@click.option(
    "--per-recording",
    metavar="NAMES",
    help="Parameters of which each recording has its own; all others are shared.",
)
@click.option("--per-robot", metavar="NAMES", help="Parameters of which each robot has its own.")
@channels_option
@noise_option
@noise_base_option
@click.option(
    "--robust",
    is_flag=True,
    help="Let samples far off count less, and lone spikes of the base tension not at all.",
)
@click.option(
    "--posterior",
    is_flag=True,
    help="Sample the posterior by NUTS too, and write its draws, as draws.csv and for ArviZ as draws.nc: "
    "minutes; needs pip install 'gtr-jax[posterior]'.",
)
@recording_options
@figures_option
@output_option
def fit(
    files: Sequence[Path],
    free: str | None,
    per_recording: str | None,
    per_robot: str | None,
    channels: str | None,
    noise: float | None,
    noise_base: float | None,
    robust: bool,
    posterior: bool,
    columns: Sequence[str],
    keep_glitches: bool,
    drop: Sequence[str],
    figures: Sequence[str],
    output: Path,
    force: bool,
) -> int:
    """Fit a robot to recordings of base and tip tension, and of what else they have of the tip's pose,
    markers and displacements, starting from the values in its file. A recording without T_tip_N is compared
    by what else it has. Several recordings share the parameters; each belongs to the ROBOT.toml before it. A
    tendon that has displacement_m without T_base_N is driven by it.
    """
    from gtr_jax.cache import enable_cache
    from gtr_jax.config.config import load_config
    from gtr_jax.recordings.thinning import MOST

    from .progress import Progress
    from .run_folder import RunFolder

    given = inputs(files)
    configs = [load_config(path) for path in given.robots]
    of = [configs[r] for r in given.of]
    recordings = read_recordings(
        given.recordings,
        [config.tendon_names for config in of],
        columns=columns,
        keep_glitches=keep_glitches,
        drop=drop,
        most=MOST,
        space=True,
        measured=True,
        markers=[[marker.name for marker in config.markers] for config in of],
    )
    options = {
        "free": None if free is None else _some(free, "--free"),
        "per_recording": () if per_recording is None else _some(per_recording, "--per-recording"),
        "per_robot": () if per_robot is None else _some(per_robot, "--per-robot"),
        "channels": channels,
        "robust": robust,
        "sampled": posterior,
    }
    paths = {f"robot {i + 1}": path for i, path in enumerate(given.robots)}
    paths |= {f"recording {i + 1}": path for i, path in enumerate(given.recordings)}
    paths |= mapping_files(columns)
    folder = RunFolder(output, paths, force=force)
    if posterior:
        from calibrate.inference.posterior_draws import require_netcdf

        require_netcdf("draws.nc")  # before minutes are spent on draws
    enable_cache()
    with Progress() as progress:
        result = solve(of, recordings, noise=noise, noise_base=noise_base, progress=progress, **options)
        progress("drawing")
        with folder.write() as part:
            settings = folder.settings() | left_out(recordings)
            write_answer(part, result, recordings, of, settings, figures=figures)
    for line in summary(result):
        click.echo(line)
    click.echo(f"report: {output / 'report.html'}")
    return 0 if result.converged else 1


def inputs(files: Sequence[Path]) -> Inputs:
    """Sort robot files from recordings; `-` is a robot file from standard input if it stands first, else a
    recording.

    Raises:
        InputError: a recording before any robot, a robot without a recording, or a recording given twice.
    """
    robots: list[Path] = []
    recordings: list[Path] = []
    of: list[int] = []
    for path in files:
        if path == STDIN:
            path = held_stdin(".csv" if robots else ".toml")
        if path.suffix.lower() == ".toml":
            if robots and len(robots) - 1 not in of:
                raise InputError(f"{robots[-1]}: no recording follows this robot; add one, or leave it out")
            robots.append(path)
        elif not robots:
            raise InputError(
                f"{path}: a recording needs the robot it was made with; give ROBOT.toml before it"
            )
        elif path.resolve() in [other.resolve() for other in recordings]:
            raise InputError(f"{path}: given twice; a recording counts once")
        else:
            recordings.append(path)
            of.append(len(robots) - 1)
    if len(robots) - 1 not in of:
        raise InputError(f"{robots[-1]}: no recording follows this robot; give REC.csv after it")
    return Inputs(robots, recordings, of)


def _some(names: str, option: str) -> str:
    """Names with commas between, of which there must be one; `calibrate.fit` takes them apart."""
    if not names.replace(",", " ").strip():
        raise InputError(f"{option}: names no parameter; give for example {option} mu")
    return names


def solve(
    robots: Sequence[RobotConfig],
    recordings: Sequence[Recording],
    *,
    noise: float | None = None,
    noise_base: float | None = None,
    progress: Any,
    **options: Any,
) -> FitResult:
    """Fit, reporting progress."""
    import calibrate

    check_noise(noise, noise_base)
    with interruption.patient():  # which leaves the fit without its profiles
        return calibrate.fit(
            robots,
            recordings,
            noise_N=noise,
            noise_base_N=noise_base,
            profiled=True,
            progress=progress,
            **options,
        )


def summary(result: FitResult) -> list[str]:
    """The estimates, then the verdict, as lines for the terminal."""
    from calibrate.report.fit import interval
    from gtr_jax.numbers import measured_quantity

    lines = []
    for e in result.estimates:
        line = f"{e.name} = {measured_quantity(e.value, e.sd, e.unit)}"
        if e.lower95 is not None:
            line += f", 95 % interval {interval(e.lower95, e.upper95, e.sd, e.unit)}"
        lines.append(line + (f" ({e.note})" if e.note else ""))
    return [*lines, *(f"warning: {text}" for text in result.warnings), result.verdict]


def _named(robots: Sequence[RobotConfig | None], recordings: Sequence[str]) -> dict[str, RobotConfig]:
    """The different robots, by what their files' names end with: nothing for the only one, their own names,
    or where these are the same those of the recordings.
    """
    different: list[RobotConfig] = []
    for robot in robots:
        if robot is not None and robot not in different:
            different.append(robot)
    if len(different) < 2:
        return dict(zip([""], different, strict=False))
    names = ["-" + re.sub(r"[^\w.-]+", "-", robot.name).strip("-") for robot in different]
    if len(set(names)) == len(names):
        return dict(zip(names, different, strict=True))
    return {f"-{name}": robot for name, robot in zip(recordings, robots, strict=True) if robot is not None}


def write_answer(
    folder: Path,
    result: FitResult,
    recordings: Sequence[Recording],
    configs: Sequence[RobotConfig],
    settings: dict[str, Any],
    *,
    figures: Sequence[str] = (),
) -> None:
    """Write all that a fit leaves into a folder: of one recording fit.csv, of several fit-NAME.csv of each;
    robot.toml and fitted.toml likewise where there are several robots; draws.csv and draws.nc of a posterior.
    """
    from calibrate.fitting.fitted import fitted_columns
    from calibrate.inference.posterior_draws import draws_columns
    from calibrate.report.fit import fit_report
    from gtr_jax.config.config import config_text, dump_config
    from gtr_jax.recordings.recording import write_recording

    from .run_folder import write_json, write_report

    for stem, robots in (("robot", configs), ("fitted", [r.config for r in result.recordings])):
        for ending, robot in _named(robots, [r.name for r in result.recordings]).items():
            dump_config(robot, folder / f"{stem}{ending}.toml")
    for recording, fitted in zip(recordings, result.recordings, strict=True):
        ending = f"-{fitted.name}" if len(recordings) > 1 else ""
        write_recording(
            folder / f"fit{ending}.csv", fitted_columns(recording, fitted), tendons=recording.tendons
        )
    if result.posterior is not None:
        write_recording(folder / "draws.csv", draws_columns(result.posterior))
        result.posterior.to_netcdf(folder / "draws.nc")
    data = result.to_json()
    write_json(folder / "fit.json", {**data, "settings": {**data["settings"], **settings}})
    report = fit_report(result, recordings, " and ".join(dict.fromkeys(c.name for c in configs)))
    files = dict.fromkeys(config_text(config) for config in configs)
    write_report(folder, report, settings, "\n".join(files), figures=figures)
