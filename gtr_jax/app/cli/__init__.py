"""The command `gtr`: init, simulate, inspect, fit, diagnose, next, design, sweep, export, view, demo, terms,
schema.

Answers go to stdout, progress and errors to stderr. Exit status: 0 answered, 1 answered but not converged
or not of any body, 2 bad input (one line on stderr), 130 interrupted. What takes long to import is imported
where a command runs.
"""

from __future__ import annotations

import logging
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import click

from gtr_jax.errors import InputError, InputWarning
from gtr_jax.interruption import INTERRUPTED, NOTHING_WRITTEN, interruption

from . import demo, design, diagnose, export, fit, init, inspect, next, schema, simulate, sweep, terms, view
from .options import with_terms_option
from .streams import withstand_closed_streams

ANSWERED, NOT_CONVERGED, BAD_INPUT = 0, 1, 2


class Interrupted(Exception):
    """The user pressed Ctrl-C."""


class Commands(click.Group):
    """A group that leaves it to `main` to say that it was interrupted."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise Interrupted from None


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit status: 0 answered, 1 not converged, 2 bad input, 130 interrupted.",
)
@click.version_option(package_name="gtr-jax", prog_name="gtr", message="%(prog)s %(version)s")
def cli() -> None:
    """Simulate tendon-driven continuum manipulators with tendon friction, fit them to recordings,
    find which physics in a recording the model leaves out, design their routing, sweep their
    parameters, and write them for CAD and MuJoCo.
    """


for _command in (init.init, inspect.inspect, demo.demo):
    cli.add_command(_command)
for _command in (
    simulate.simulate,
    fit.fit,
    diagnose.diagnose,
    next.next_,
    design.design,
    sweep.sweep,
    export.export,
    view.view,
    terms.terms,
    schema.schema,
):
    cli.add_command(with_terms_option(_command))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the entry point of `gtr`.

    Args:
        arguments: what follows `gtr`; those of the process unless given.

    Returns:
        The exit status.
    """
    _quieten()
    if arguments is None:
        withstand_closed_streams()
        interruption.install()
        interruption.running = True
    with warnings.catch_warnings():
        if not sys.warnoptions:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", InputWarning)
        warnings.showwarning = _warned(warnings.showwarning)
        status = _run(list(sys.argv[1:] if arguments is None else arguments))
    if status == INTERRUPTED and arguments is None:
        # JAX may still be computing in threads of its own, which crash when the interpreter is taken down.
        if sys.stdout is not None:
            sys.stdout.flush()
        os._exit(status)
    return status


def _run(arguments: list[str]) -> int:
    interruption.says = NOTHING_WRITTEN
    try:
        return _answered(arguments)
    except Exception:
        if not interruption.arrived:
            raise
        return _interrupted()  # what a library made of it


def _answered(arguments: list[str]) -> int:
    try:
        _check_names(arguments)
        status = cli.main(arguments, prog_name="gtr", standalone_mode=False, obj=arguments)
        if sys.stdout is not None:
            sys.stdout.flush()
        return status or ANSWERED
    except click.exceptions.NoArgsIsHelpError as help_wanted:
        help_wanted.show()
        return BAD_INPUT
    except click.UsageError as fault:
        help_line = f"; see '{fault.ctx.command_path} --help'" if fault.ctx else ""
        return _refuse(fault.format_message().rstrip(".") + help_line)
    except click.ClickException as fault:
        return _refuse(fault.format_message())
    except InputError as fault:
        return _refuse(str(fault))
    except OSError as fault:
        place = f"{fault.filename or 'output'}: {fault.strerror or fault}"
        return _refuse(f"{place}; check the path, whether it may be used, and the room on its disk")
    except (Interrupted, KeyboardInterrupt, click.Abort):
        return _interrupted()


def _check_names(arguments: Sequence[str]) -> None:
    """InputError if an argument is not text: reports and run.json, in UTF-8, could not name that file."""
    for argument in arguments:
        try:
            argument.encode()
        except UnicodeEncodeError:
            raise InputError(f"{argument}: this name is not in UTF-8; rename the file or folder") from None


def _interrupted() -> int:
    click.echo(interruption.says, err=True)
    return INTERRUPTED


def _refuse(message: str) -> int:
    click.echo(f"error: {' '.join(message.split())}", err=True)
    return BAD_INPUT


def _warned(otherwise: Callable[..., None]) -> Callable[..., None]:
    """What shows warnings: those of input as a line of their own, each once; others as before."""
    said: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if not issubclass(category, InputWarning):
            otherwise(message, category, *where, **more)
        elif str(message) not in said:
            said.add(str(message))
            click.echo(f"warning: {message}", err=True)

    return show


def _quieten() -> None:
    """Keep libraries' remarks (which accelerators JAX tried, that matplotlib looks for fonts) off stderr."""
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    for name in ("jax", "jax._src.xla_bridge", "matplotlib"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
