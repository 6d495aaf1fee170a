"""`gtr view`: the live page of a robot."""

from __future__ import annotations

import secrets
import threading
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gtr_jax.errors import InputError
from gtr_jax.interruption import interruption

from .options import InputFile, robot_argument
from .recordings import read_recordings, recording_options

if TYPE_CHECKING:
    from gtr_jax.recordings.recording import Recording

MOST = 600  # samples that a recording is thinned to, so that a shape follows its slider within 50 ms
NEEDED = "gtr view needs Bokeh, which is not installed; pip install 'gtr-jax[view]'"
OUT = "gtr-view"


@click.command()
@robot_argument
@click.argument("recording", metavar="[REC.csv]", required=False, type=InputFile(".csv"))
@click.option(
    "--port", type=int, default=0, metavar="PORT", help="Port to serve the page on.  [default: a free one]"
)
@click.option("--no-browser", is_flag=True, help="Only print the address; do not open a browser.")
@click.option(
    "-o",
    "--output",
    metavar="OUT",
    type=click.Path(path_type=Path),
    default=Path(OUT),
    help=f"Folder that the page saves robot files, fits and diagnoses in.  [default: {OUT}]",
)
@recording_options
def view(
    robot: Path,
    recording: Path | None,
    port: int,
    no_browser: bool,
    output: Path,
    columns: Sequence[str],
    keep_glitches: bool,
    drop: Sequence[str],
) -> int:
    """Open ROBOT.toml as a live page in the browser of this machine: a slider for every number, the body, the
    loop and the forces along the channel, simulated again as they move, beside REC.csv if it is given.

    The page is served to this machine only, to one browser for each address that is printed. Ctrl-C ends it.
    """
    from gtr_jax.cache import enable_cache
    from gtr_jax.config.config import load_config

    try:
        import bokeh  # noqa: F401
    except ImportError:
        raise InputError(NEEDED) from None
    config = load_config(robot)
    given: Recording | None = None
    options: list[str] = []
    if recording is None:
        for name, value in (("--columns", columns), ("--keep-glitches", keep_glitches), ("--drop", drop)):
            if value:
                raise InputError(f"{name}: has no effect without a recording; leave it out")
    else:
        given = read_recordings(
            [recording],
            [config.tendon_names],
            columns=columns,
            keep_glitches=keep_glitches,
            drop=drop,
            need_tip=False,
            measured=True,
            most=MOST,
            space=True,
            markers=[[marker.name for marker in config.markers]],
        )[0]
        options += [part for value in columns for part in ("--columns", value)]
        options += [part for value in drop for part in ("--drop", value)]
        options += ["--keep-glitches"] if keep_glitches else []
    if output.exists() and not output.is_dir():
        raise InputError(f"-o {output}: is a file; name a folder")
    enable_cache()
    from gtr_jax.app.view.page import Given, Page, fill
    from gtr_jax.app.view.redirect import Redirect
    from gtr_jax.app.view.server import Server

    pages: list[Page] = []
    what = Given(config, given, options, output, f"runs-{secrets.token_urlsafe(12)}")
    server = Server(lambda document: fill(document, what, pages), output, what.shown_at, port)

    def another() -> None:
        click.echo(f"for another browser: {server.address(another)}", err=True)

    click.echo(f"{config.name}: {server.address(another)}")
    click.echo("Ctrl-C ends it", err=True)
    redirect = None
    with interruption.patient():
        try:
            if not no_browser:
                redirect = Redirect(server.address(lambda: redirect.remove() if redirect else None))
                if redirect.path is None:
                    click.echo("no folder here is closed to others: open the address yourself", err=True)
                else:
                    # Some browsers end only when they are closed.
                    start = threading.Thread(
                        target=webbrowser.open, args=(redirect.path.as_uri(),), daemon=True
                    )
                    start.start()
            server.run()
        except KeyboardInterrupt:
            click.echo("closing", err=True)
        finally:
            for page in pages:
                page.close()
            for page in pages:
                page.wait()
            server.close()
            if redirect is not None:
                redirect.remove()
    return 0
