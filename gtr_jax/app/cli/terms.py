"""`gtr terms`: the physics beyond the paper."""

from __future__ import annotations

from pathlib import Path

import click

from gtr_jax.errors import InputError, did_you_mean

from .options import InputFile, Quantity


@click.command()
@click.argument("kind", required=False)
@click.option(
    "--law",
    "robot",
    metavar="ROBOT.toml",
    type=InputFile(".toml"),
    help="Describe and draw the laws that a robot file states, by what they do to a loop of that robot.",
)
@click.option(
    "--pull",
    type=Quantity("N", "TENSION"),
    help="Tension to which the loop goes [N].  [default: 40 N]",
)
@click.option(
    "--pictures",
    metavar="FOLDER",
    type=click.Path(path_type=Path, file_okay=False),
    help="Where the pictures go.  [default: the present folder]",
)
def terms(kind: str | None, robot: Path | None, pull: float | None, pictures: Path | None) -> None:
    """List the physics terms, or show the one called KIND: its law, numbers and how to tell it apart. KIND
    `law` is one of your own, which a robot file states as an expression.
    """
    from gtr_jax.config.form import LAW
    from gtr_jax.report.terms import description, overview
    from gtr_jax.terms import REGISTRY

    if robot is not None:
        if kind is not None:
            raise InputError("terms: KIND has no effect beside --law; leave one of them out")
        draw_laws(robot, pull, Path(".") if pictures is None else pictures)
        return
    for option, value in (("--pull", pull), ("--pictures", pictures)):
        if value is not None:
            raise InputError(f"terms: {option} has no effect without --law; leave it out")
    if kind is None:
        click.echo(overview())
    elif kind == LAW:
        from gtr_jax.report.laws import law_text

        click.echo(law_text())
    elif kind in REGISTRY:
        click.echo(description(REGISTRY[kind]))
    else:
        raise InputError(f"terms: no term '{kind}'; {did_you_mean(kind, (*REGISTRY, LAW))}")


def draw_laws(robot: Path, pull: float | None, folder: Path) -> None:
    """Describe the laws of a robot file, and draw a loop with and without each."""
    from gtr_jax.cache import enable_cache
    from gtr_jax.config.config import load_config
    from gtr_jax.plots.terms import term_figure
    from gtr_jax.report.laws import law_description, law_loops, laws_of, shown_size
    from gtr_jax.report.term_pages import FAST, PULL
    from gtr_jax.report.terms import value_text

    config = load_config(robot)
    tension = PULL if pull is None else pull
    if tension <= 0:
        raise InputError(f"--pull: must be above 0 N, is {tension:g} N; pull harder")
    enable_cache()
    for section in laws_of(config):
        click.echo(law_description(config, section))
        loops = law_loops(config, section, tension)
        path = folder / f"{section.id}.png"
        folder.mkdir(parents=True, exist_ok=True)
        path.write_bytes(term_figure(config.catalogue[section.id], loops, FAST))
        size = value_text(shown_size(section), section.as_law.size.unit)
        click.echo(f"\npicture, with size {size}: {path}\n")
