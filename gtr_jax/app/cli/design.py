"""`gtr design`: the routing that reaches a target."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gtr_jax.errors import InputError

from .options import UNITS, check_resolution, figures_option, output_option, robot_argument

if TYPE_CHECKING:
    from design import Design, TargetConfig
    from gtr_jax.config.config import RobotConfig

RESOLUTION = 0.5


@click.command()
@robot_argument
@click.argument("target", metavar="TARGET.toml", type=click.Path(path_type=Path))
@click.option(
    "--against",
    type=click.Path(path_type=Path),
    metavar="PLAIN.toml",
    help="Design with this plainer model too, and tell how far its design would miss in ROBOT.toml.  "
    "[default: the same robot without its terms, if it has any]",
)
@click.option(
    "--resolution",
    type=float,
    default=RESOLUTION,
    show_default=True,
    metavar="FACTOR",
    help="Factor on the mesh of the search; what is found is checked on a mesh of 4.",
)
@click.option(
    "--unit", type=click.Choice(UNITS), default="mm", show_default=True, help="Unit of the drawings for CAD."
)
@click.option(
    "--step",
    is_flag=True,
    help="Write the channels and the body as STEP too; needs pip install 'gtr-jax[cad]'.",
)
@figures_option
@output_option
def design(
    robot: Path,
    target: Path,
    against: Path | None,
    resolution: float,
    unit: str,
    step: bool,
    figures: Sequence[str],
    output: Path,
    force: bool,
) -> int:
    """Choose the routing of ROBOT.toml, and whatever else TARGET.toml frees, so that the tip is where
    TARGET.toml wants it, within its limits.

    Where no design does, the nearest is written, with what stands in the way; the exit status
    is then 1.
    """
    from gtr_jax.cache import enable_cache
    from gtr_jax.config.config import load_config

    from .progress import Progress
    from .run_folder import RunFolder

    check_resolution(resolution)
    if step:
        from gtr_jax.export.step import check_installed

        check_installed()
    config = load_config(robot)
    plain = None if against is None else load_config(against)
    paths = {"robot": robot, "target": target} | ({"against": against} if against else {})
    wanted = _load_target(target)
    if wanted.robust.fit is not None and (fit := wanted.beside(wanted.robust.fit, "robust.fit")).is_file():
        paths["fit"] = fit
    folder = RunFolder(output, paths, force=force)
    enable_cache()
    with Progress() as progress:
        answer = solve(config, wanted, against=plain, resolution=resolution, progress=progress)
        progress("drawing")
        with folder.write() as part:
            write_answer(part, answer, config, folder.settings(), figures=figures, unit=unit, step=step)
    click.echo(f"{answer.verdict}: {answer.says}")
    click.echo(f"report: {output / 'report.html'}")
    return 0 if answer.verdict in ("reached", "optimal") else 1


def _load_target(path: Path) -> TargetConfig:
    from design import load_target

    if path.suffix.lower() == ".csv":
        raise InputError(f"{path}: is not a target file; write a TARGET.toml with [[pose]]")
    return load_target(path)


def solve(config: RobotConfig, target: TargetConfig, *, progress: Any, **options: Any) -> Design:
    """Design, reporting progress."""
    import design

    return design.optimise(config, target, progress=progress, **options)


def write_answer(
    folder: Path,
    answer: Design,
    config: RobotConfig,
    settings: dict[str, Any],
    *,
    figures: Sequence[str] = (),
    unit: str = "mm",
    step: bool = False,
) -> None:
    """Write all that a design leaves into a folder; drawings for CAD in a unit, as STEP too if `step`."""
    from design.report.design import design_report
    from design.target import target_text
    from gtr_jax.atomic_write import write_atomically
    from gtr_jax.config.config import config_text, dump_config
    from gtr_jax.recordings.formats.text import read_text

    from .run_folder import write_json, write_report

    target = answer.problem.target
    if target.robust.fit is not None:
        fit, _ = read_text(target.beside(target.robust.fit, "robust.fit"))
        write_atomically(folder / "fit.json", fit)  # beside the target file, as it says
        target = target.model_copy(update={"robust": target.robust.model_copy(update={"fit": "fit.json"})})
    dump_config(config, folder / "robot.toml")
    write_atomically(folder / "target.toml", target_text(target))
    dump_config(answer.config, folder / "designed.toml")
    _draw(folder, answer.config, target, unit=unit, step=step)
    write_json(folder / "design.json", {**answer.to_json(), "settings": settings})
    write_report(folder, design_report(answer), settings, config_text(answer.config), figures=figures)


def _draw(folder: Path, config: RobotConfig, target: TargetConfig, *, unit: str, step: bool) -> None:
    """Write the channel for those who make it: in the plane a route and drawings of the body, in space or of
    several tendons a curve of each and the unrolled body.
    """
    from design.drawing import draw, route_csv, svg
    from design.unrolled import channel_csv, svg_unrolled, unroll
    from gtr_jax.atomic_write import write_atomically
    from gtr_jax.export.dxf import dxf

    limits = target.limits
    sheet = dxf(
        config,
        unit=unit,
        channel_diameter=limits.channel_diameter,
        wall_clearance=limits.wall_clearance or None,
    )
    if step:
        from gtr_jax.export.step import step as written

        write_atomically(folder / "designed.step", written(config, unit=unit))
    if not (config.in_space or config.tendons):
        drawn = draw(config, channel_diameter=limits.channel_diameter)
        write_atomically(folder / "route.csv", route_csv(drawn))
        write_atomically(folder / "channel.svg", svg(drawn, f"{target.name}: channel at 1:1, mm"))
        write_atomically(folder / "channel.dxf", sheet)
        return
    channels = unroll(config)
    for channel in channels:
        name = f"channel-{channel.name}.csv" if channel.name else "channel.csv"
        write_atomically(folder / name, channel_csv(channel))
    title = f"{target.name}: the body unrolled at 1:1, mm"
    write_atomically(folder / "unrolled.svg", svg_unrolled(config, channels, title))
    write_atomically(folder / "channels.dxf", sheet)
