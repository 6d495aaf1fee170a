"""Options that several commands share, and quantities with units on the command line."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gtr_jax.errors import InputError

if TYPE_CHECKING:
    from gtr_jax.config.amount import Amount


class Quantity(click.ParamType):
    """A number in SI, or one with its unit: 45, "45 N", "4.6 kgf"."""

    def __init__(self, unit: str, metavar: str) -> None:
        self.unit = unit
        self.name = metavar

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The value in SI; InputError naming the option."""
        from gtr_jax.units import to_si

        where = param.opts[0] if param else self.name
        try:
            value = float(value)
        except ValueError:
            pass
        return to_si(value, self.unit, where)


class Pull(Quantity):
    """A tension, in newtons without a unit, or a displacement with its unit of length."""

    def __init__(self) -> None:
        super().__init__("N", "AMOUNT")

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Amount:
        """The amount in SI; InputError naming the option."""
        from gtr_jax.config.amount import Amount, amount_of

        if isinstance(value, Amount):
            return value
        text = str(value)
        try:
            value = float(value)
        except ValueError:
            pass
        try:
            return amount_of(value)._replace(text=text)
        except InputError as fault:
            raise InputError(f"{param.opts[0] if param else self.name}: {fault}") from None


UNITS = ("mm", "cm", "m", "in")  # of drawings, as `gtr_jax.export.unit` has them
STDIN = Path("-")
TERMS_VARIABLE = "GTR_JAX_TERMS"  # as `gtr_jax.terms.own` reads it, which would import JAX
HELD = f"{__name__}.stdin"  # where a command's context keeps the file that holds it


class InputFile(click.Path):
    """A file to read, or `-`: standard input, which is kept in a file for as long as the command runs.

    Args:
        ending: that the file gets, by which readers tell what it is.
    """

    def __init__(self, ending: str) -> None:
        super().__init__(path_type=Path)
        self.ending = ending

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path; of standard input, that of the file that holds it."""
        path = super().convert(value, param, ctx)
        return held_stdin(self.ending, ctx) if path == STDIN else path


def held_stdin(ending: str, context: click.Context | None = None) -> Path:
    """A file `stdin` with this ending that holds standard input until the command ends.

    Raises:
        InputError: it is read already, nothing comes from it, or too much does.
    """
    from gtr_jax.recordings.formats.text import read_all

    context = context or click.get_current_context()
    if HELD in context.meta:
        raise InputError("-: standard input can be read once; give the other file by its name")
    data = read_all(sys.stdin.buffer, "-")
    if not data.strip():
        raise InputError(
            f"-: nothing comes from standard input; send it a file, as in 'gtr ... < file{ending}'"
        )
    folder = Path(context.with_resource(tempfile.TemporaryDirectory(prefix="gtr-")))
    context.meta[HELD] = folder / f"stdin{ending}"
    context.meta[HELD].write_bytes(data)
    return context.meta[HELD]


def _use_terms(context: click.Context, param: click.Parameter, files: tuple[Path, ...]) -> None:
    """Have the files looked for when the terms are imported, in this process and in those that it starts."""
    if not files:
        return
    if "gtr_jax.terms" in sys.modules:  # the command line in somebody's own process
        raise InputError(f"--terms: terms are known already; set {TERMS_VARIABLE} before Python starts")
    before = [path for path in os.environ.get(TERMS_VARIABLE, "").split(os.pathsep) if path]
    os.environ[TERMS_VARIABLE] = os.pathsep.join([*before, *(str(path.resolve()) for path in files)])


def own_terms() -> dict[str, Path]:
    """The files that hold terms of the user's own, by the role that a run folder records them under."""
    files = [path for path in os.environ.get(TERMS_VARIABLE, "").split(os.pathsep) if path]
    return {f"terms {i + 1}": Path(path) for i, path in enumerate(files)}


def with_terms_option(command: click.Command) -> click.Command:
    """A command with --terms FILE.py, whose terms are known to it."""
    option = click.Option(
        ["--terms"],
        metavar="FILE.py",
        multiple=True,
        type=click.Path(path_type=Path),
        expose_value=False,
        is_eager=True,
        callback=_use_terms,
        help="Python file with physics terms of your own, each a TERM; it is executed. Repeatable.",
    )
    command.params.append(option)
    return command


robot_argument = click.argument("robot", metavar="ROBOT.toml", type=InputFile(".toml"))
OUTPUT_HELP = (
    "Run folder to write. An earlier run of the same command there is replaced; anything else is left alone "
    "and refused."
)
force_option = click.option("--force", is_flag=True, help="Replace whatever the run folder holds.")


def output_option(command: Callable) -> Callable:
    """-o OUT and --force, for the parameters `output` and `force`."""
    place = click.option(
        *("-o", "--output"),
        required=True,
        metavar="OUT",
        type=click.Path(path_type=Path),
        help=OUTPUT_HELP,
    )
    return place(force_option(command))


files_argument = click.argument(
    "files", nargs=-1, required=True, metavar="ROBOT.toml REC.csv ...", type=click.Path(path_type=Path)
)
figures_option = click.option(
    "--figures",
    type=click.Choice(["svg", "pdf", "png"]),
    multiple=True,
    help="Write the figures for papers too, one or two columns wide (88 or 181 mm), into OUT/figures. "
    "Repeatable.",
)
channels_option = click.option(
    "--channels",
    metavar="NAMES",
    help="What to compare beside a recorded T_tip, where a recording has it: some of tip_x, tip_y, "
    "tip_angle, displacement, names of markers, and in space tip_z, tip_rotation; '' for nothing.  "
    "[default: all]",
)
noise_option = click.option(
    "--noise",
    type=Quantity("N", "SD"),
    help="Standard deviation of the recorded tip tension.  [default: estimated from the recording]",
)
noise_base_option = click.option(
    "--noise-base",
    type=Quantity("N", "SD"),
    help="The same of the base tension; 0 takes it as exact.  [default: estimated from the recording]",
)
resolution_option = click.option(
    "--resolution",
    type=float,
    default=1.0,
    show_default=True,
    metavar="FACTOR",
    help="Factor on the number of mesh intervals.",
)


def check_noise(noise: float | None, noise_base: float | None) -> None:
    """Refuse standard deviations that are not valid."""
    for name, value in (("--noise", noise), ("--noise-base", noise_base)):
        if value is not None and (value < 0 or (value == 0 and name == "--noise")):
            least = "positive" if name == "--noise" else "positive, or 0 for an exact one"
            raise InputError(f"{name}: a standard deviation is {least}; this is {value:g} N")


def check_resolution(resolution: float) -> None:
    """Refuse a mesh factor that cannot be computed with."""
    if not 0.1 <= resolution <= 100:
        raise InputError(f"--resolution: must lie between 0.1 and 100, is {resolution:g}; 1 is the default")
