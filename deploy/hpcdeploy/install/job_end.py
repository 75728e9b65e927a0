"""Ends the jobs of a head that stays when its cluster goes."""

from __future__ import annotations

from hpccomponent.errors import CloudError
from hpcdeploy.login.shell import Shell
from hpcdeploy.spec.layout import machine_folder

TIMEOUT_S = 60.0


def end_jobs(head: Shell, cluster: str) -> None:
    """End all jobs of a cluster whose head stays when the cluster goes.

    Raises CloudError where they do not end.
    """
    folder = machine_folder(cluster)
    done = head.run(
        f"cd {folder} && [ -d jobs ] && [ -x venv/bin/python ] || exit 0; "
        "exec venv/bin/python -P -m hpcdeploy.jobs.runner --folder . end",
        timeout_s=TIMEOUT_S,
    )
    if done.exit_code != 0:
        raise CloudError(
            f"{head.node}: its jobs do not end ({done.reason[-200:]})",
            f"end them by hand, see {folder}/jobs",
        )
