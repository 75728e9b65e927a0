"""The verb ``reap``."""

from __future__ import annotations

from pathlib import Path

import click

from hpccomponent.cli.terminal import echo
from hpccomponent.cli.verb import Verb
from hpcdeploy.cli.arguments import FILES
from hpcdeploy.cli.asking import say


@click.command(
    cls=Verb,
    examples=[
        (
            "hpcapp reap --dry-run",
            "Say what would be removed from the AWS account of the environment.",
        ),
        ("hpcapp reap lab.yaml --dry-run", "Say it of the cloud of a cluster file."),
        ("hpcapp reap lab.yaml", "Remove it."),
    ],
)
@FILES
@click.option("--dry-run", is_flag=True, help="Only say what would be removed.")
def reap(files: tuple[Path, ...], dry_run: bool) -> None:
    """Remove what has expired or belongs to nobody.

    Goes by the clouds' own lists.
    """
    from hpcdeploy.providers.clouds import open_clouds
    from hpcdeploy.reconcile.reap import overdue
    from hpcdeploy.reconcile.reap import reap as remove_overdue
    from hpcdeploy.reconcile.removal import describe
    from hpcdeploy.spec.polling import utc_now

    for where, provider, _ in open_clouds(files):
        if dry_run:
            remains = describe(overdue(provider.observe(None), utc_now()))
            echo(f"{where}: {f'would remove {remains}' if remains else 'nothing to remove'}")
        else:
            remove_overdue(provider, say)
            echo(f"{where}: nothing expired or orphaned is left")
