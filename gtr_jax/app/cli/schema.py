"""`gtr schema`: the JSON Schema of the robot file."""

import json

import click


@click.command()
def schema() -> None:
    """Print the JSON Schema of the robot file, with which editors complete and check such files."""
    from gtr_jax.config.schema import json_schema

    click.echo(json.dumps(json_schema(), indent=2))
