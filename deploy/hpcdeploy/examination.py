"""What `doctor` looks at: the cloud, the wheels, and every machine that runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

from hpccomponent.errors import CloudError
from hpccomponent.runtime.numerics import package_version
from hpcdeploy.bootstrap import MIN_FREE, check_wheels
from hpcdeploy.cluster import Cluster
from hpcdeploy.layout import machine_folder
from hpcdeploy.probe import Probed, probe
from hpcdeploy.provider import MachineSeen, Problem
from hpcdeploy.shell import Shell

__all__ = ["examine"]

AT_ONCE = 16
WAIT_S = 30.0
MAX_SKEW_S = 30  # more, and a lease ends at another time than it says
_VERSION = (
    "cd {folder} 2>/dev/null && venv/bin/python -P -c "
    "'from importlib.metadata import version; print(version(\"hpcapp\"))'"
)


def examine(cluster: Cluster, report: Callable[[str], None]) -> Iterator[Problem]:
    """Yield what is wrong; nothing is changed.

    Parameters
    ----------
    cluster : Cluster
    report : callable
        Takes a line for each thing that has been looked at.
    """
    for what, found in (
        ("cloud", cluster.provider.check()),
        ("wheels", check_wheels(cluster.spec, cluster.access.base)),
    ):
        yield from _told(what, found, report)
    machines = cluster.machines()
    with ThreadPoolExecutor(AT_ONCE, thread_name_prefix="doctor") as pool:
        for machine, found in zip(
            machines, pool.map(lambda m: list(_visit(cluster, m)), machines), strict=True
        ):
            yield from _told(machine.name.node, found, report)


def _told(what: str, found: list[Problem], report: Callable[[str], None]) -> list[Problem]:
    if not found:
        report(f"{what}: good")
    for problem in found:
        advice = f"; {problem.advice}" if problem.advice else ""
        report(f"{what}: {problem.what}{advice}")
    return found


def _visit(cluster: Cluster, machine: MachineSeen) -> Iterator[Problem]:
    """Yield what is wrong with a machine that runs."""
    folder = machine_folder(cluster.spec.cluster)
    try:
        with cluster.access.open(machine, WAIT_S) as shell:
            probed = probe(shell, cluster.spec.cluster, folder, cluster.spec.env.python)
            yield from _findings(probed, _version(shell, folder))
    except CloudError as error:
        yield Problem(error.problem, error.advice)


def _version(shell: Shell, folder: str) -> str:
    return shell.run(_VERSION.format(folder=folder)).output.strip()


def _findings(probed: Probed, version: str) -> Iterator[Problem]:
    skew = probed.clock - time.time()
    if abs(skew) > MAX_SKEW_S:
        yield Problem(f"its clock is {skew:+.0f} s off", "run a time service there", is_fatal=False)
    if probed.free < MIN_FREE:
        yield Problem(f"its disk has {probed.free >> 20} MiB left", "make room there")
    if version != package_version():
        found = f"hpcapp {version}" if version else "no hpcapp"
        yield Problem(f"{found} is installed, not {package_version()}", "run hpcapp up", False)
    elif not probed.is_running:
        yield Problem("its loader does not run", "run hpcapp up; see loader.log", is_fatal=False)
