"""The verb ``doctor``: looks, without changing anything, for what would go wrong."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hpccomponent.errors import CloudError
from hpccomponent.terminal import echo

if TYPE_CHECKING:
    from hpcdeploy.provider import Problem

__all__ = ["doctor"]

FILE = click.Path(dir_okay=False, path_type=Path)


@click.command()
@click.argument("file", type=FILE)
def doctor(file: Path) -> None:
    """Check credentials, rights, image, types, wheels and machines of the cluster file FILE."""
    from hpcdeploy.reconcile.cluster import open_cluster
    from hpcdeploy.reconcile.examination import examine

    with open_cluster(file) as cluster:
        problems = list(examine(cluster, echo))
    fatal = [problem for problem in problems if problem.is_fatal]
    if fatal:
        raise CloudError(f"{len(fatal)} of {len(problems)} findings would make 'up' fail")
    echo(f"cluster {cluster.spec.cluster}: {_verdict(problems)}")


def _verdict(problems: list[Problem]) -> str:
    return f"{len(problems)} findings, none fatal" if problems else "nothing to complain of"
