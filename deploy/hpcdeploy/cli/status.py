"""The verbs ``status`` and ``ls``: what is there, from the cloud and not from memory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hpccomponent.terminal import echo, echo_json

if TYPE_CHECKING:
    from hpcdeploy.reconcile.status import ClusterLine

__all__ = ["ls", "status"]

FILE = click.Path(dir_okay=False, path_type=Path)


@click.command()
@click.argument("file", type=FILE)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.option("--offline", is_flag=True, help="Do not ask the machines, only the cloud.")
def status(file: Path, as_json: bool, offline: bool) -> None:
    """Show the machines of the cluster file FILE, their loaders, the lease and the cost."""
    from hpcdeploy.reconcile.cluster import open_cluster
    from hpcdeploy.reconcile.status import describe_cluster, write_table

    with open_cluster(file) as cluster:
        described = describe_cluster(cluster, ask_machines=not offline)
    if as_json:
        echo_json(described)
    else:
        echo(write_table(described))


@click.command()
@click.argument("files", nargs=-1, type=FILE)
@click.option("--all", "is_all", is_flag=True, help="Every cluster of the account.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def ls(files: tuple[Path, ...], is_all: bool, as_json: bool) -> None:
    """List the clusters of the files FILES, or all of their accounts.

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
