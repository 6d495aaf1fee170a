"""`gtr simulate`: a robot through a load history."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gtr_jax.errors import InputError, did_you_mean, listed

from .options import (
    InputFile,
    Pull,
    Quantity,
    check_resolution,
    figures_option,
    output_option,
    resolution_option,
    robot_argument,
)
from .recordings import left_out, mapping_files, read_recordings, recording_options

if TYPE_CHECKING:
    import numpy as np

    from gtr_jax.config.amount import Amount
    from gtr_jax.config.config import RobotConfig
    from gtr_jax.recordings.driving import Drive
    from gtr_jax.recordings.recording import Recording
    from gtr_jax.report.simulation_answer import SimulationAnswer
    from gtr_jax.simulation.history import Simulation

STEPS = 40


@click.command()
@robot_argument
@click.option(
    "--pull",
    type=Pull(),
    help="Pull the tendon's base to this tension [N], or by this length where displacement drives it.",
)
@click.option("--release", type=Pull(), help="Then release it to this one.")
@click.option(
    "--tendon",
    metavar="NAME",
    help="Of several tendons, pull this one; the others keep their preload, or their place.",
)
@click.option("--steps", type=int, metavar="N", help=f"Steps of each branch.  [default: {STEPS}]")
@click.option(
    "--dt",
    type=Quantity("s", "TIME"),
    help="Time of each step [s], for physics terms that depend on it; a history has a column time_s.",
)
@click.option(
    "--history",
    type=InputFile(".csv"),
    metavar="H.csv",
    help="Take the base tension from this file (column T_base_N, or T_base_N.NAME for each of several "
    "tendons) instead; a tendon that has displacement_m without it is driven by displacement.",
)
@recording_options
@resolution_option
@click.option(
    "--movie",
    metavar="FILE",
    help="Write a movie of the body and its loop, OUT/FILE: a name that ends in .gif, or in .mp4, for which "
    "ffmpeg must be installed.",
)
@figures_option
@output_option
def simulate(
    robot: Path,
    pull: Amount | None,
    release: Amount | None,
    tendon: str | None,
    steps: int | None,
    dt: float | None,
    history: Path | None,
    columns: Sequence[str],
    keep_glitches: bool,
    drop: Sequence[str],
    resolution: float,
    movie: str | None,
    figures: Sequence[str],
    output: Path,
    force: bool,
) -> int:
    """Simulate ROBOT.toml through a history of the base tension.

    Either --pull, and --release after it, or --history. Tensions take units ("45 N", "4.6 kgf"); a bare
    number is in newtons. Of several tendons, --tendon names the one to pull; a history has a column
    T_base_N.NAME for each.
    """
    from gtr_jax.cache import enable_cache
    from gtr_jax.config.config import load_config

    from .progress import Progress
    from .run_folder import RunFolder

    check_resolution(resolution)
    if movie is not None:
        from gtr_jax.plots.movie import check_movie

        check_movie(movie)
    config = load_config(robot)
    given: Recording | None = None
    if history is None:
        for name, value in (("--columns", columns), ("--keep-glitches", keep_glitches), ("--drop", drop)):
            if value:
                raise InputError(f"{name}: has no effect without --history; leave it out")
        drive = pulls_of(config, tendon, pull, release, steps)
        if dt is not None and dt <= 0:
            raise InputError(f"--dt: must be positive, is {dt:g} s; 0.1 s for example")
        time = None if dt is None else times_of(dt, len(drive.T_base))
    else:
        alone = {"--pull": pull, "--release": release, "--steps": steps, "--dt": dt, "--tendon": tendon}
        for name, value in alone.items():
            if value is not None:
                raise InputError(f"{name}: has no effect with --history; leave one of the two out")
        given = read_recordings(
            [history],
            [config.tendon_names],
            columns=columns,
            keep_glitches=keep_glitches,
            drop=drop,
            need_tip=False,
            space=True,
        )[0]
        from gtr_jax.recordings.driving import driven

        config, drive, time = *driven(config, given), given.time
    check_times(config, time)
    paths = {"robot": robot, **({"history": history} if history else {}), **mapping_files(columns)}
    folder = RunFolder(output, paths, force=force)
    enable_cache()
    with Progress() as progress:
        answer = solve(config, drive, time, resolution=resolution, progress=progress)
        progress("drawing")
        with folder.write() as part:
            settings = folder.settings() | left_out([given] if given else [])
            write_answer(part, answer, config, settings, time=time, figures=figures)
            if movie is not None:
                from gtr_jax.report.simulation_movie import simulation_movie

                progress("drawing the movie")
                simulation_movie(part / movie, answer)
    from gtr_jax.report.simulation import verdict

    said = verdict(answer)
    for text in answer.warnings:
        click.echo(f"warning: {text}", err=True)
    click.echo(said)
    click.echo(f"report: {output / 'report.html'}")
    return 0 if answer.converged and not answer.impossible.means_nothing else 1


def pulls_of(
    config: RobotConfig, tendon: str | None, pull: Amount | None, release: Amount | None, steps: int | None
) -> Drive:
    """The history of a pull and release of one tendon, the others at their preload or place."""
    import numpy as np

    from gtr_jax.config.amount import unit_of
    from gtr_jax.recordings.driving import Drive
    from gtr_jax.units import to_si

    names = config.tendon_names
    if tendon is not None and tendon not in names:
        remedy = (
            did_you_mean(tendon, names)
            if names
            else "the robot's one tendon carries no name; leave --tendon out"
        )
        raise InputError(f"--tendon: no tendon '{tendon}'; {remedy}")
    if names and tendon is None:
        raise InputError(
            f"--tendon: which of {listed(names)} to pull? name one, or give all with --history H.csv"
        )
    strung = {name: own for name, own, _ in config.strung}
    pulled = strung[tendon or ""]
    unit = unit_of(pulled.drive)
    start = pulled.preload if unit == "N" else 0.0
    for option, given in (("--pull", pull), ("--release", release)):
        if given is not None and given.unit != unit:
            if unit == "N":
                to_si(given.text, "N", option)  # which says what is wrong with it
            raise InputError(
                f"{option}: the tendon is driven by displacement; give for example {option} '10 mm'"
            )
    if (
        pull is not None
        and pull.value == start
        and release is None
        and steps is None
        and _something_acts(config)
    ):
        way = np.array([start])  # the one state at rest, under loads and preloads alone
    else:
        way = pull_and_release(
            None if pull is None else pull.value,
            None if release is None else release.value,
            steps,
            start,
            unit=unit,
        )

    def column(name: str, kind: str) -> np.ndarray:
        own = strung[name]
        if own.drive != kind:
            return np.full_like(way, np.nan)
        if name == (tendon or ""):
            return way
        return np.full_like(way, own.preload if kind == "tension" else 0.0)

    T_base, displacement = (
        np.stack([column(name, kind) for name in names], axis=1) if names else column("", kind)
        for kind in ("tension", "displacement")
    )
    return Drive(T_base, displacement if any(own.drive != "tension" for own in strung.values()) else None)


def _something_acts(config: RobotConfig) -> bool:
    """Whether anything bends a robot, or tightens a tendon, that nobody pulls."""
    numbers = config.numbers()
    loaded = any(
        value or key == "loads.gravity_angle" for key, value in numbers.items() if key.startswith("loads.")
    )
    return loaded or bool(config.terms) or any(tendon.preload > 0 for _, tendon, _ in config.strung)


def pull_and_release(
    pull: float | None, release: float | None, steps: int | None, start: float = 0.0, *, unit: str = "N"
) -> np.ndarray:
    """Base tension [N] of a pull from `start`, a preload, and, if asked for, a release, with `steps` steps
    each; displacement with `unit` "m".
    """
    import numpy as np

    from gtr_jax.config.checks import mm

    def said(amount: float) -> str:
        return f"{amount:g} N" if unit == "N" else mm(amount)

    if pull is None:
        raise InputError(
            "--pull: missing; give a tension, for example --pull 45 --release 0, or --history H.csv"
        )
    count = STEPS if steps is None else steps
    if not 1 <= count <= 100_000:
        raise InputError(f"--steps: must lie between 1 and 100000, is {count}; {STEPS} is the default")
    if pull <= start:
        beyond = "the preload of" if unit == "N" else "its place at"
        raise InputError(f"--pull: must be above {beyond} {said(start)}, is {said(pull)}; pull harder")
    history = np.linspace(start, pull, count + 1)
    if release is None:
        return history
    if not 0 <= release < pull:
        raise InputError(
            f"--release: must lie between {said(0.0)} and the {said(pull)} of --pull, is {said(release)}; "
            "change one"
        )
    return np.concatenate([history, np.linspace(pull, release, count + 1)[1:]])


def times_of(dt: float, count: int) -> np.ndarray:
    """Times [s] of so many steps of `dt` [s], the first at zero."""
    import numpy as np

    return dt * np.arange(count)


def check_times(config: RobotConfig, time: np.ndarray | None) -> None:
    """InputError if a physics term acts that needs the time of the steps, and there is none."""
    for term in config.catalogue.values():
        values = config.term_values[term.id]
        if time is None and term.timed and any(values[q.name] != q.null for q in term.sizes):
            raise InputError(
                f"{config.source}: {term.id} depends on time; give it with --dt, or a history with a "
                "column time_s"
            )


def solve(
    config: RobotConfig,
    drive: Drive,
    time: np.ndarray | None = None,
    *,
    resolution: float = 1.0,
    progress,
) -> SimulationAnswer:
    """Build the robot and simulate.

    Raises:
        InputError: tensions so large that no state is left to draw.
    """
    import numpy as np

    from gtr_jax.report.simulation_answer import answer_simulation
    from gtr_jax.robot.build import build_robot

    robot = build_robot(config, resolution=resolution)
    progress("compiling and simulating")
    answer = answer_simulation(robot, drive.T_base, time, displacement=drive.displacement)
    # Lost where nothing is finite, or where no solution is found and the rod would turn by more than half a
    # turn from one node to the next.
    run = answer.run
    turns = np.max(_turns(run), axis=-1) > np.pi
    lost = ~np.all(np.isfinite(np.asarray(run.tip_pose)), axis=-1) | (turns & ~np.asarray(run.converged))
    if lost.any():
        first = float(np.max(np.asarray(run.T_base)[int(np.argmax(lost))]))
        raise InputError(
            f"{config.source}: at a base tension of {first:.3g} N no shape is found; is the unit "
            "right? give less in --pull or in the history"
        )
    return answer


def _turns(run: Simulation) -> np.ndarray:
    """Angle [rad] by which the body turns from one node to the next, (K, N-1)."""
    import numpy as np

    if run.shape is None:
        return np.abs(np.diff(np.asarray(run.angle), axis=-1))
    size = np.linalg.norm(np.asarray(run.shape.strain), axis=-1)
    return 0.5 * (size[:, 1:] + size[:, :-1]) * np.diff(np.asarray(run.s))


def write_answer(
    folder: Path,
    answer: SimulationAnswer,
    config: RobotConfig,
    settings: dict,
    *,
    time: np.ndarray | None = None,
    figures: Sequence[str] = (),
) -> None:
    """Write all that a simulation leaves into a folder."""

    from gtr_jax.config.config import dump_config
    from gtr_jax.recordings.recording import write_recording
    from gtr_jax.report.profile import profile
    from gtr_jax.report.simulation import facts, simulation_report
    from gtr_jax.robot.channel_table import channel_curve
    from gtr_jax.simulation.tables import simulation_columns

    from .run_folder import write_json, write_report

    run = answer.run
    dump_config(config, folder / "robot.toml")
    columns = simulation_columns(run, answer.robot, timed=time is not None)
    write_recording(folder / "simulation.csv", columns, tendons=config.tendon_names)
    for tendon in answer.robot.tendons if answer.robot.space else ():
        name = f"channel-{tendon.name}.csv" if tendon.name else "channel.csv"
        write_recording(folder / name, channel_curve(answer.robot, tendon))
    write_recording(folder / "profile.csv", profile(answer.loaded), tendons=config.tendon_names)
    write_json(folder / "simulation.json", {**facts(answer), "settings": settings})
    report = simulation_report(answer, time)
    robot = (folder / "robot.toml").read_text(encoding="utf-8")
    write_report(folder, report, settings, robot, figures=figures)
