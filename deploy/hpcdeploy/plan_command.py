"""The verbs ``validate`` and ``plan``: what a cluster file says, and what it would lead to."""

from __future__ import annotations

from pathlib import Path

import click

__all__ = ["plan", "validate"]

FILE = click.Path(dir_okay=False, path_type=Path)


@click.command()
@click.argument("file", type=FILE)
def validate(file: Path) -> None:
    """Name every mistake in the cluster file FILE; asks no network."""
    from hpcdeploy.spec import read_spec

    spec = read_spec(file)
    click.echo(f"{file}: valid: cluster {spec.cluster}, provider {spec.provider.type}")


@click.command()
@click.argument("file", type=FILE)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def plan(file: Path, as_json: bool) -> None:
    """Show what `up` would create or change, and what it costs an hour and at most."""
