"""The verb ``doctor``: looks, without changing anything, for what would go wrong."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hpccomponent.cli.terminal import echo
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import CloudError
from hpcdeploy.cli.arguments import FILE

if TYPE_CHECKING:
    from hpcdeploy.provider import Problem


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp doctor lab.yaml", "Name what would make 'up' fail, and what mends it."),
        ("hpcapp -q doctor lab.yaml", "Check in a script, by the exit code: 0 or 4."),
        ("hpcapp doctor lab.yaml --debug", "Show what was asked of the cloud."),
    ],
)
@FILE
def doctor(file: Path) -> None:
    """Check all that 'up' needs; changes nothing.

    Looks at credentials, rights, image, types, wheels, and the machines that are there.
    """
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
