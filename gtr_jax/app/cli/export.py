"""`gtr export`: a robot for CAD and for MuJoCo."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from gtr_jax.errors import InputError
from gtr_jax.interruption import interruption

from .options import UNITS, Quantity, robot_argument

DXF, STEP, MJCF = "dxf", "step", "mjcf"
ENDINGS = {DXF: (".dxf",), STEP: (".step", ".stp"), MJCF: (".xml", ".mjcf")}
OF = {  # which options have an effect on which format
    "unit": (DXF, STEP),
    "tolerance": (DXF, STEP),
    "links": (MJCF,),
    "friction_at": (MJCF,),
}
FINEST = 1e-8  # m, the least tolerance


@click.command()
@robot_argument
@click.option(
    "--to",
    "kind",
    type=click.Choice([DXF, STEP, MJCF]),
    help="dxf: a drawing with layers and dimensions. step: the channels as curves in space, the body as a "
    "solid; needs pip install 'gtr-jax[cad]'. mjcf: a model for MuJoCo.  [default: by the ending of FILE]",
)
@click.option(
    *("-o", "--output"),
    required=True,
    metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False),
    help="File to write: .dxf, .step or .xml.",
)
@click.option("--unit", type=click.Choice(UNITS), help="Unit of a drawing.  [default: mm]")
@click.option(
    "--tolerance",
    type=Quantity("m", "LENGTH"),
    help="How far splines may lie from the lines they stand for, as 1um.  [default: 1 um]",
)
@click.option("--links", type=int, metavar="N", help="Rigid links of a model for MuJoCo.  [default: 40]")
@click.option(
    "--friction-at",
    type=Quantity("N", "TENSION"),
    help="Let tendons in MuJoCo pull with the share of the base tension that friction leaves on average "
    "along them, when they are pulled to this one.  [default: no friction]",
)
@click.option("--force", is_flag=True, help="Replace a file that is there.")
def export(robot: Path, kind: str | None, output: Path, force: bool, **given: Any) -> int:
    """Write ROBOT.toml, which may be a fitted, diagnosed or designed one, for other programs: its unloaded
    body and channels at 1:1 for CAD, or a chain of rigid links for MuJoCo.

    The command says what of the robot MuJoCo does not support.
    """
    from gtr_jax.atomic_write import write_atomically
    from gtr_jax.config.config import load_config

    interruption.says = f"interrupted: {output} was not written"
    kind = _kind(output, kind)
    options = {name: value for name, value in given.items() if value is not None}
    for name in options:
        if kind not in OF[name]:
            raise InputError(
                f"--{name.replace('_', '-')}: has no effect on {kind}, only on {' and '.join(OF[name])}; "
                "leave it out"
            )
    _check(options)
    if output.exists() and not force:
        raise InputError(f"{output}: is there already; choose another name, or replace it with --force")
    config = load_config(robot)
    with _named(robot):
        text = _text(kind, config, options)
        with interruption.writing(output):
            write_atomically(output, text)
    click.echo(f"{kind}: {output}")
    if kind == MJCF:
        from gtr_jax.export.mjcf import left_out

        if out := left_out(config, friction_at=options.get("friction_at")):
            click.echo(f"left out, because MuJoCo or this export does not support it: {', '.join(out)}")
    return 0


def _kind(output: Path, kind: str | None) -> str:
    """The format, by its name or by the ending of the file."""
    ending = output.suffix.lower()
    by_ending = next((name for name, endings in ENDINGS.items() if ending in endings), None)
    if kind is None and by_ending is None:
        raise InputError(f"{output}: its ending names no format; say --to dxf, --to step or --to mjcf")
    if kind is not None and by_ending not in (None, kind):
        raise InputError(f"{output}: ends as {by_ending}, but --to says {kind}; change one of the two")
    return kind or str(by_ending)


def _check(options: dict[str, Any]) -> None:
    from gtr_jax.export.mjcf import LINKS, MOST_LINKS

    if options.get("tolerance", 1.0) < FINEST:
        raise InputError(
            f"--tolerance: must be at least {FINEST:g} m, is {options['tolerance']:g} m; 1um is usual"
        )
    if not 2 <= options.get("links", LINKS) <= MOST_LINKS:
        raise InputError(f"--links: must lie between 2 and {MOST_LINKS}, is {options['links']}")
    if options.get("friction_at", 1.0) <= 0:
        raise InputError("--friction-at: must be a base tension above 0; leave it out for no friction")


@contextlib.contextmanager
def _named(robot: Path) -> Iterator[None]:
    """What cannot be computed as a line that names the robot file."""
    try:
        yield
    except (ValueError, RuntimeError) as fault:
        if isinstance(fault, InputError):
            raise
        raise InputError(f"{robot}: {fault}") from None


def _text(kind: str, config: Any, options: dict[str, Any]) -> str:
    if kind == DXF:
        from gtr_jax.export.dxf import dxf

        return dxf(config, **options)
    if kind == STEP:
        from gtr_jax.export.step import step

        return step(config, **options)
    from gtr_jax.export.mjcf import mjcf

    return mjcf(config, **options)
