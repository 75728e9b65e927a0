"""The verbs ``up``, ``down`` and ``scale``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hpccomponent.cli.verb import Verb
from hpccomponent.errors import OutdatedError
from hpcdeploy.cli.arguments import FILE
from hpcdeploy.cli.asking import ask_to_go_on, name_foreign, say
from hpcdeploy.spec.names import MOST_WORKERS

if TYPE_CHECKING:
    from hpcdeploy.reconcile.cluster import Cluster
    from hpcdeploy.reconcile.plan import ClusterPlan


YES = click.option("-y", "--yes", is_flag=True, help="Do not ask.")
UNCHECKED = click.option(
    "--skip-checks", "is_unchecked", is_flag=True,
    help="Launch machines even where something is known to be missing.",
)  # fmt: skip
KEEP = click.option(
    "--keep", is_flag=True, help="Leave what was made where the cluster cannot be made whole."
)


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp up lab.yaml", "Show what will be made and what it costs, ask, and make it."),
        ("hpcapp up lab.yaml -y", "Do not ask, in a script."),
        (
            "hpcapp up lab.yaml --keep",
            "Leave what was made where the cluster cannot be made whole.",
        ),
    ],
)
@FILE
@YES
@KEEP
@UNCHECKED
def up(file: Path, yes: bool, keep: bool, is_unchecked: bool) -> None:
    """Make a cluster's machines and set them up.

    Run again, it makes and mends what is missing.
    """
    from hpcdeploy.reconcile.cluster import open_cluster

    with open_cluster(file) as cluster:
        _bring_up(cluster, yes, keep, is_unchecked)


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp down lab.yaml", "Take the cluster away."),
        ("hpcapp down lab.yaml -y", "Never ask, in a script."),
        ("hpcapp down lab.yaml --name lab", "Take away a cluster that was made from another home."),
    ],
)
@FILE
@YES
@click.option("--name", default="", metavar="CLUSTER", help="Its name, where it is another's.")
def down(file: Path, yes: bool, name: str) -> None:
    """Take away all machines, and prove that nothing is left.

    A cluster that was made elsewhere goes only where its name is typed, or given by --name.
    """
    from hpcdeploy.reconcile.cluster import open_cluster
    from hpcdeploy.reconcile.converge import take_down

    with open_cluster(file) as cluster:
        while True:
            named = name_foreign(cluster, "take it away", is_asked=not yes, given=name)
            try:
                take_down(cluster, say, named=named)
            except OutdatedError as error:
                if name:
                    raise
                say(error.problem)
                continue
            say(f"cluster {cluster.spec.cluster}: nothing is left")
            return


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp scale lab.yaml 8", "Show what eight workers cost, ask, and bring it to eight."),
        ("hpcapp scale lab.yaml 0 -y", "Keep the head alone."),
        (
            "hpcapp scale lab.yaml 3 --skip-checks",
            "Launch machines even where something is known to be missing.",
        ),
    ],
)
@FILE
@click.argument("workers", type=click.IntRange(0, MOST_WORKERS), help="How many there are to be.")
@YES
@KEEP
@UNCHECKED
def scale(file: Path, workers: int, yes: bool, keep: bool, is_unchecked: bool) -> None:
    """Bring a cluster to another number of workers.

    The file stays as it is: the next 'up' goes back to its number.
    """
    from dataclasses import replace

    from hpcdeploy.reconcile.cluster import open_cluster

    with open_cluster(file) as cluster:
        count = cluster.spec.worker_count
        scaled = replace(cluster, spec=cluster.spec.scaled(workers))
        _bring_up(scaled, yes, keep, is_unchecked)
        if count != workers:
            say(f"the next hpcapp up goes back to {count}: see workers.count")


def _bring_up(cluster: Cluster, yes: bool, keep: bool, is_unchecked: bool) -> None:
    """Show what is to be done, ask, do it; ask again where it would be something else by then."""
    from hpcdeploy.reconcile.converge import bring_up

    while True:
        ahead = _look_ahead(cluster, is_unchecked)
        if ahead.actions and not yes:
            ask_to_go_on(cluster)
        try:
            bring_up(cluster, say, keep=keep, agreed=None if yes else ahead)
        except OutdatedError as error:
            say(error.problem)
            continue
        say(f"cluster {cluster.spec.cluster} is up: {len(cluster.machines())} machines")
        return


def _look_ahead(cluster: Cluster, is_unchecked: bool) -> ClusterPlan:
    """Return the plan once it is shown, and nothing is known to stand in its way."""
    from hpcdeploy.install.wheels.requirements import check_wheels
    from hpcdeploy.reconcile.converge import look_ahead
    from hpcdeploy.reconcile.cost import check_limits, describe_cost, estimate_cost
    from hpcdeploy.reconcile.drift import describe_drift
    from hpcdeploy.reconcile.preflight import check_ready

    ahead, cost = look_ahead(cluster), estimate_cost(cluster.spec)
    actions = ahead.actions
    planned = (f"will {action}" for action in actions)
    decided = cluster.provider.decided() if actions else ()
    drift = describe_drift(cluster.spec, ahead.kept, cluster.path)
    for line in (*planned, *drift, *decided, *ahead.obstacles(), *describe_cost(cost)):
        say(line)
    missing = check_wheels(cluster.spec, cluster.path.absolute().parent) if actions else []
    for problem in missing:
        say(f"missing: {problem.what}; {problem.advice}")
    check_limits(cluster.spec, cost)  # before the user is asked
    if not is_unchecked:
        check_ready(cluster, actions, missing, say)
    return ahead
