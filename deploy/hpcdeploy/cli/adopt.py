"""The verb ``adopt``."""

from __future__ import annotations

from pathlib import Path

import click

from hpccomponent.terminal import echo

__all__ = ["adopt"]

FILE = click.Path(dir_okay=False, path_type=Path)


@click.command()
@click.argument("file", type=FILE)
@click.option("--key", type=click.Path(exists=True, dir_okay=False, path_type=Path), metavar="KEY",
              help="Its owner's private key; it is copied.")  # fmt: skip
@click.option("-y", "--yes", is_flag=True, help="Do not ask.")
def adopt(file: Path, key: Path | None, yes: bool) -> None:
    """Take over the cluster of FILE, which was made elsewhere, with its owner's key."""
    from hpccomponent.errors import CloudError
    from hpcdeploy.reconcile.adoption import check_way_in, take_over
    from hpcdeploy.reconcile.cluster import open_cluster

    def say(line: str) -> None:
        echo(line, err=True)

    with open_cluster(file) as cluster:
        name = cluster.spec.cluster
        observed, keys = check_way_in(cluster, key)
        owners = {machine.owner.user for machine in observed.machines if machine.owner.user}
        say(f"cluster {name} of {', '.join(sorted(owners)) or 'somebody'} lets us in")
        if not yes:
            typed = click.prompt("Type the cluster's name to take it over", err=True)
            if typed.strip() != name:
                raise CloudError(f"{typed!r} is not its name: nothing was done")
        take_over(cluster, observed, keys, key, say)
