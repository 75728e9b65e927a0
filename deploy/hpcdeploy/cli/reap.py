"""The verb ``reap``."""

from __future__ import annotations

from pathlib import Path

import click

from hpccomponent.terminal import echo

__all__ = ["reap"]


@click.command()
@click.argument("files", nargs=-1, type=click.Path(dir_okay=False, path_type=Path))
@click.option("--dry-run", is_flag=True, help="Only say what would be removed.")
def reap(files: tuple[Path, ...], dry_run: bool) -> None:
    """Remove what has expired or belongs to nobody, by the cloud's own lists.

    Looks at the clouds of the cluster files FILES, or at the AWS account of the environment.
    """
    from hpcdeploy.providers.clouds import open_clouds
    from hpcdeploy.reconcile.reap import overdue
    from hpcdeploy.reconcile.reap import reap as remove_overdue
    from hpcdeploy.reconcile.removal import describe
    from hpcdeploy.spec.polling import utc_now

    def say(line: str) -> None:
        echo(line, err=True)

    for where, provider, _ in open_clouds(files):
        if dry_run:
            remains = describe(overdue(provider.observe(None), utc_now()))
            echo(f"{where}: {f'would remove {remains}' if remains else 'nothing to remove'}")
        else:
            remove_overdue(provider, say)
            echo(f"{where}: nothing expired or orphaned is left")
