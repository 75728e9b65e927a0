"""The verbs ``up``, ``down`` and ``scale``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from hpcdeploy.cluster import Cluster

__all__ = ["down", "scale", "up"]

FILE = click.Path(dir_okay=False, path_type=Path)
YES = click.option("-y", "--yes", is_flag=True, help="Do not ask.")
KEEP = click.option(
    "--keep", is_flag=True, help="Leave what was made where the cluster cannot be made whole."
)


@click.command()
@click.argument("file", type=FILE)
@YES
@KEEP
def up(file: Path, yes: bool, keep: bool) -> None:
    """Make the machines of the cluster file FILE and set them up; run again, it converges."""
    from hpcdeploy.cluster import open_cluster

    with open_cluster(file) as cluster:
        _bring_up(cluster, yes, keep)


@click.command()
@click.argument("file", type=FILE)
def down(file: Path) -> None:
    """Take away all machines of the cluster file FILE, and prove that nothing is left."""
    from hpcdeploy.cluster import open_cluster
    from hpcdeploy.converge import take_down

    with open_cluster(file) as cluster:
        take_down(cluster, _say)
        _say(f"cluster {cluster.spec.cluster}: nothing is left")


@click.command()
@click.argument("file", type=FILE)
@click.argument("workers", type=click.IntRange(0, 1000))
@YES
@KEEP
def scale(file: Path, workers: int, yes: bool, keep: bool) -> None:
    """Bring the cluster of FILE to so many WORKERS; the file stays as it is."""
    from dataclasses import replace

    from hpcdeploy.cluster import open_cluster

    with open_cluster(file) as cluster:
        spec = cluster.spec
        chosen = spec.workers.model_copy(update={"count": workers, "min": None})
        scaled = replace(cluster, spec=spec.model_copy(update={"workers": chosen}))
        _bring_up(scaled, yes, keep)
        if spec.worker_count != workers:
            _say(f"the next hpcapp up goes back to {spec.worker_count}: see workers.count")


def _bring_up(cluster: Cluster, yes: bool, keep: bool) -> None:
    """Show what is to be done, ask, do it."""
    from hpcdeploy.bootstrap import check_wheels
    from hpcdeploy.converge import bring_up, look_ahead
    from hpcdeploy.cost import check_limits, describe_cost, estimate_cost

    actions, cost = look_ahead(cluster).actions, estimate_cost(cluster.spec)
    for line in (*(f"will {action}" for action in actions), *describe_cost(cost)):
        _say(line)
    for problem in check_wheels(cluster.spec, cluster.path.absolute().parent) if actions else ():
        _say(f"missing: {problem.what}; {problem.advice}")
    check_limits(cluster.spec, cost)  # before the user is asked
    if actions and not yes:
        click.confirm("Go on?", abort=True, err=True)
    bring_up(cluster, _say, keep=keep)
    _say(f"cluster {cluster.spec.cluster} is up: {len(cluster.machines())} machines")


def _say(line: str) -> None:
    click.echo(line, err=True)
