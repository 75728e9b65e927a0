"""The verbs ``status`` and ``ls``: what is there, from the cloud and not from memory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hpccomponent.cli.named_files import json_option
from hpccomponent.cli.terminal import echo, echo_json
from hpccomponent.cli.verb import Verb
from hpcdeploy.cli.arguments import FILE, FILES

if TYPE_CHECKING:
    from hpcdeploy.reconcile.status import ClusterLine


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp status lab.yaml", "Show all machines, and whether their loaders run."),
        ("hpcapp status lab.yaml --offline", "Ask the cloud only, and no machine."),
        ("hpcapp status lab.yaml --json", "The same for a program."),
    ],
)
@FILE
@json_option("Print one JSON object.")
@click.option("--offline", is_flag=True, help="Do not ask the machines, only the cloud.")
def status(file: Path, as_json: bool, offline: bool) -> None:
    """Show a cluster's machines, loaders, lease and cost."""
    from hpcdeploy.reconcile.cluster import open_cluster
    from hpcdeploy.reconcile.status import describe_cluster, write_table

    with open_cluster(file) as cluster:
        described = describe_cluster(cluster, ask_machines=not offline)
    if as_json:
        echo_json(described)
    else:
        echo(write_table(described))


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp ls lab.yaml cloud.yaml", "List the clusters of two files."),
        ("hpcapp ls --all", "List all of the AWS account of the environment."),
        ("hpcapp ls lab.yaml --all --json", "List all of one cloud, for a program."),
    ],
)
@FILES
@click.option("--all", "is_all", is_flag=True, help="Every cluster of the account.")
@json_option("Print one JSON object.")
def ls(files: tuple[Path, ...], is_all: bool, as_json: bool) -> None:
    """List clusters, by the clouds' own lists.

    With --all and no file, all of the AWS account of the environment.
    """
    from hpccomponent.errors import CloudError, UsageError
    from hpcdeploy.providers.clouds import open_clouds
    from hpcdeploy.reconcile.status import list_clusters, write_list
    from hpcdeploy.spec.cluster import read_spec

    if not files and not is_all:
        raise UsageError("no cluster file is given", "name some, or add --all")
    names = None if is_all else {read_spec(path).cluster for path in files}
    rows: list[ClusterLine] = []
    silent: list[CloudError] = []
    for where, provider, spec in open_clouds(files):
        try:
            listed = list_clusters(where, provider.observe(None), spec)
        except CloudError as error:  # the other clouds are listed all the same
            silent.append(error)
            continue
        rows += [row for row in listed if names is None or row["cluster"] in names]
    if rows or not silent:
        if as_json:
            echo_json(rows)
        else:
            echo(write_list(rows))
    for other in silent[1:]:
        echo(f"hpcapp: {other}", err=True)
    if silent:
        raise silent[0]
