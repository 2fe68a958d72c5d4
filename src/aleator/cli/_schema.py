"""`aleator schema`: what may stand in a study file."""

import json

import typer

from aleator.studies import schema


def print_schema() -> None:
    """Print the JSON Schema of study files (.toml), by which editors complete and check them."""
    typer.echo(json.dumps(schema(), indent=2, ensure_ascii=False))
