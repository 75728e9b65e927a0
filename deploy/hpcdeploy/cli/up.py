"""The verbs ``up``, ``down`` and ``scale``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hpccomponent.errors import UsageError
from hpccomponent.terminal import echo

if TYPE_CHECKING:
    from hpcdeploy.reconcile.cluster import Cluster

__all__ = ["ask_name", "down", "scale", "up"]

FILE = click.Path(dir_okay=False, path_type=Path)
YES = click.option("-y", "--yes", is_flag=True, help="Do not ask.")
UNCHECKED = click.option(
    "--skip-checks", "is_unchecked", is_flag=True,
    help="Launch machines even where something is known to be missing.",
)  # fmt: skip
KEEP = click.option(
    "--keep", is_flag=True, help="Leave what was made where the cluster cannot be made whole."
)


@click.command()
@click.argument("file", type=FILE)
@YES
@KEEP
@UNCHECKED
def up(file: Path, yes: bool, keep: bool, is_unchecked: bool) -> None:
    """Make the machines of the cluster file FILE and set them up; run again, it converges."""
    from hpcdeploy.reconcile.cluster import open_cluster

    with open_cluster(file) as cluster:
        _bring_up(cluster, yes, keep, is_unchecked)


@click.command()
@click.argument("file", type=FILE)
@YES
@click.option("--name", default="", metavar="CLUSTER", help="Its name, where it is another's.")
def down(file: Path, yes: bool, name: str) -> None:
    """Take away all machines of the cluster file FILE, and prove that nothing is left.

    A cluster that was made elsewhere goes only where its name is typed, or given by --name.
    """
    from hpcdeploy.reconcile.cluster import open_cluster
    from hpcdeploy.reconcile.converge import take_down

    with open_cluster(file) as cluster:
        is_named = ask_name(cluster, "take it away", is_asked=not yes, given=name)
        take_down(cluster, _say, is_named=is_named)
        _say(f"cluster {cluster.spec.cluster}: nothing is left")


def ask_name(cluster: Cluster, purpose: str, *, is_asked: bool, given: str = "") -> bool:
    """Let the user name a cluster that was made elsewhere; tell whether it was.

    Parameters
    ----------
    cluster : Cluster
    purpose : str
        What is done to it, as an infinitive: "take it away".
    is_asked : bool
        Whether the user may be asked to type the name.
    given : str
        The name from the command line; empty where there is none.

    Returns
    -------
    bool

    Raises
    ------
    CloudError
        It was, and is not named: it says whose it is.
    UsageError
        Another cluster is named.
    """
    from hpccomponent.errors import CloudError, UsageError
    from hpcdeploy.reconcile.cluster import require_ours

    name = cluster.spec.cluster
    if given not in ("", name):
        raise UsageError(f"the file's cluster is {name}, not {given}", "give the right file")
    try:
        require_ours(cluster, cluster.provider.observe(name))
    except CloudError as error:
        if given == name:
            return True
        advice = f"give --name {name} to {purpose}"
        if not is_asked:
            raise CloudError(error.problem, advice) from None
        _say(error.problem)
        try:
            typed = click.prompt(f"Type the cluster's name to {purpose}", err=True)
        except click.Abort:
            raise CloudError(error.problem, advice) from None
        if typed.strip() != name:
            raise CloudError(f"{typed!r} is not its name: nothing was done", advice) from None
        return True
    return False


@click.command()
@click.argument("file", type=FILE)
@click.argument("workers", type=click.IntRange(0, 1000))
@YES
@KEEP
@UNCHECKED
def scale(file: Path, workers: int, yes: bool, keep: bool, is_unchecked: bool) -> None:
    """Bring the cluster of FILE to so many WORKERS; the file stays as it is."""
    from dataclasses import replace

    from hpcdeploy.reconcile.cluster import open_cluster

    with open_cluster(file) as cluster:
        count = cluster.spec.worker_count
        scaled = replace(cluster, spec=cluster.spec.scaled(workers))
        _bring_up(scaled, yes, keep, is_unchecked)
        if count != workers:
            _say(f"the next hpcapp up goes back to {count}: see workers.count")


def _bring_up(cluster: Cluster, yes: bool, keep: bool, is_unchecked: bool) -> None:
    """Show what is to be done, ask, do it."""
    from hpcdeploy.machine.bootstrap import check_wheels
    from hpcdeploy.reconcile.converge import bring_up, look_ahead
    from hpcdeploy.reconcile.cost import check_limits, describe_cost, estimate_cost
    from hpcdeploy.reconcile.preflight import check_ready

    ahead, cost = look_ahead(cluster), estimate_cost(cluster.spec)
    actions = ahead.actions
    planned = (f"will {action}" for action in actions)
    decided = cluster.provider.decided() if actions else ()
    for line in (*planned, *decided, *ahead.obstacles(), *describe_cost(cost)):
        _say(line)
    missing = check_wheels(cluster.spec, cluster.path.absolute().parent) if actions else []
    for problem in missing:
        _say(f"missing: {problem.what}; {problem.advice}")
    check_limits(cluster.spec, cost)  # before the user is asked
    if not is_unchecked:
        check_ready(cluster, actions, missing, _say)
    if actions and not yes:
        _ask(cluster)
    bring_up(cluster, _say, keep=keep)
    _say(f"cluster {cluster.spec.cluster} is up: {len(cluster.machines())} machines")


def _ask(cluster: Cluster) -> None:
    """Ask whether to go on."""
    try:
        click.confirm("Go on?", abort=True, err=True)
    except click.Abort:
        if sys.stdin.isatty():
            raise
        _say("")  # the question's own line is not ended
        raise UsageError(
            f"cluster {cluster.spec.cluster} is not changed: this is not a terminal, and the "
            "question was not answered with yes",
            "run it with -y",
        ) from None


def _say(line: str) -> None:
    echo(line, err=True)
