"""`gtr terms`: the physics beyond the paper."""

from __future__ import annotations

import click

from gtr_jax.errors import InputError, did_you_mean


@click.command()
@click.argument("kind", required=False)
def terms(kind: str | None) -> None:
    """List the physics terms, or show the one called KIND: its law, numbers and how to tell it apart."""
    from gtr_jax.report.terms import description, overview
    from gtr_jax.terms import REGISTRY

    if kind is None:
        click.echo(overview())
        return
    if kind not in REGISTRY:
        raise InputError(f"terms: no term '{kind}'; {did_you_mean(kind, tuple(REGISTRY))}")
    click.echo(description(REGISTRY[kind]))
