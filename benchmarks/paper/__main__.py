"""`python -m benchmarks.paper -o paper-out`: the paper reproduced."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import click

from gtr_jax.app.cli.options import output_option
from gtr_jax.app.cli.progress import Progress
from gtr_jax.app.cli.run_folder import RunFolder, write_json
from gtr_jax.cache import enable_cache
from gtr_jax.errors import InputError

from . import pages
from .studies import studies

FIGURES, PROGRAM = "paper", "python -m benchmarks.paper"


@click.command()
@output_option
def paper(output: Path, force: bool) -> int:
    """Reproduce Liu & Alambeigi (RA-L 2022): its figures, its numbers, and what it leaves open.

    Writes report.html, paper.md with its pictures (the page of the docs), paper.json with every number, and
    the robot files. Takes a minute or two.
    """
    again = shlex.join([*PROGRAM.split(), "-o", str(output)])
    folder = RunFolder(output, {}, force=force, command=again)
    enable_cache()
    with Progress() as progress:
        parts = studies(progress)
        progress("writing")
        with folder.write() as part:
            settings = folder.settings()
            for name in (FIGURES, "robots"):
                (part / name).mkdir()
            for study in parts:
                for figure in study.figures:
                    (part / FIGURES / f"{figure.name}.png").write_bytes(figure.image)
                for name, text in study.robots.items():
                    (part / "robots" / name).write_text(text, encoding="utf-8")
            (part / "paper.md").write_text(pages.markdown(parts, FIGURES), encoding="utf-8")
            (part / "report.html").write_text(pages.html(parts, settings), encoding="utf-8")
            write_json(part / "paper.json", {**pages.facts(parts), "settings": settings})
    click.echo(pages.verdict(parts))
    click.echo(f"report: {output / 'report.html'}")
    return 0 if pages.converged(parts) else 1


if __name__ == "__main__":
    try:
        sys.exit(paper.main(prog_name=PROGRAM, standalone_mode=False))
    except InputError as fault:
        click.echo(f"error: {fault}", err=True)
        sys.exit(2)
    except click.ClickException as fault:
        fault.show()
        sys.exit(fault.exit_code)
