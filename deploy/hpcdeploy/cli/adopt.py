"""The verb ``adopt``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hpccomponent.cli.named_files import InputFile
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import HpcError, OutdatedError
from hpcdeploy.cli.arguments import FILE
from hpcdeploy.cli.asking import ask_name, say

if TYPE_CHECKING:
    from hpcdeploy.provider import Observed
    from hpcdeploy.reconcile.cluster import Cluster


WAIT_S = 30.0  # the head has just let us in


@click.command(
    cls=Verb,
    examples=[
        (
            "hpcapp adopt lab.yaml --key owner.pem",
            "Show whose it is and what runs there, ask, and take it over.",
        ),
        ("hpcapp adopt lab.yaml", "Take it over with the key that is here."),
        ("hpcapp adopt lab.yaml --key owner.pem -y", "Do not ask."),
    ],
)
@FILE
@click.option("--key", type=InputFile(exists=True), metavar="KEY",
              help="Its owner's private key; it is copied.")  # fmt: skip
@click.option("-y", "--yes", is_flag=True, help="Do not ask.")
def adopt(file: Path, key: Path | None, yes: bool) -> None:
    """Take over a cluster that was made elsewhere.

    It needs its owner's key.
    """
    from hpcdeploy.reconcile.adoption import check_way_in, take_over
    from hpcdeploy.reconcile.cluster import open_cluster

    with open_cluster(file) as cluster:
        while True:
            observed, keys = check_way_in(cluster, key)
            owners = {machine.owner.user for machine in observed.machines if machine.owner.user}
            name = cluster.spec.cluster
            say(f"cluster {name} of {', '.join(sorted(owners)) or 'somebody'} lets us in")
            _tell_jobs(cluster, observed)
            if not yes:
                ask_name(cluster, "take it over", "run it with -y")
            try:
                take_over(cluster, observed, keys, key, say)
            except OutdatedError as error:
                if yes:
                    raise
                say(error.problem)
                continue
            return


def _tell_jobs(cluster: Cluster, observed: Observed) -> None:
    """Say which jobs are under way, for whoever takes the cluster over from under them."""
    from hpcdeploy.jobs.queries import Jobs
    from hpcdeploy.provider import State
    from hpcdeploy.spec.names import HEAD

    running = [machine for machine in observed.machines if machine.state is State.RUNNING]
    for head in (machine for machine in running if machine.name.node == HEAD):
        try:
            with cluster.access.open(head, WAIT_S) as shell:
                jobs = Jobs(shell, cluster.spec.cluster).all()
        except HpcError as error:
            say(f"whether a job runs there is not known: {error.problem}")
            return
        for job in jobs:
            if not job.state.is_over:
                say(f"job {job.job} ({job.title}) is {job.state}; it goes on")
