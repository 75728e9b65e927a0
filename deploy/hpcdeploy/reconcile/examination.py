"""What `doctor` looks at, and `up` before it launches anything: cloud, wheels, and machines."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence

from hpccomponent.cli.terminal import write_block
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CloudError
from hpccomponent.runtime.numerics import package_version
from hpcdeploy.install.bootstrap import MIN_FREE
from hpcdeploy.install.probe import DAMAGED, Probed, no_python, probe
from hpcdeploy.install.wheels.requirements import check_wheels, missing_wheels
from hpcdeploy.login.parallel import connections_at_once, run_parallel
from hpcdeploy.provider import MachineSeen, Problem
from hpcdeploy.reconcile.cluster import Cluster
from hpcdeploy.spec.layout import machine_folder, state_folder
from hpcdeploy.spec.names import HEAD, without_node

WAIT_S = 10.0  # until a machine lets us in
ANSWER_S = 15.0  # until it has said all that it is asked
MAX_SKEW_S = 30  # more, and a lease ends at another time than it says


@dataclass(frozen=True, slots=True)
class Visit:
    """What has been seen on a machine.

    `about` is what it is, where that is known: its Python, its architecture, its room.
    """

    machine: MachineSeen
    problems: tuple[Problem, ...]
    about: str = ""


def examine(
    cluster: Cluster,
    report: Callable[[str], None],
    *,
    wait_s: float = WAIT_S,
    answer_s: float = ANSWER_S,
) -> Iterator[Problem]:
    """Yield what is wrong; nothing is changed.

    A machine may take `wait_s` to let us in and `answer_s` to answer, in seconds.
    """
    yield from _told("state folder", list(_state_problems(cluster)), "", report)
    machines = cluster.provider.hosts()
    if not machines:
        problems = []
        try:
            machines = cluster.machines()
            problems = cluster.provider.check()
        except CloudError as error:  # all else that it would be asked fails too
            problems = [Problem(error.problem, error.advice)]
        yield from _told("cloud", problems, "", report)
    wheels = check_wheels(cluster.spec, cluster.access.base)
    yield from _told("wheels", wheels, "", report)
    for seen in visit(cluster, machines, wait_s=wait_s, answer_s=answer_s):
        yield from _told(seen.machine.name.node, seen.problems, seen.about, report)


def visit(
    cluster: Cluster,
    machines: Sequence[MachineSeen],
    *,
    wait_s: float = WAIT_S,
    answer_s: float = ANSWER_S,
) -> list[Visit]:
    """Log in to machines, several at once, and look at each; nothing is changed.

    A machine may take `wait_s` to let us in and `answer_s` to answer, in seconds.
    """

    def look(machine: MachineSeen) -> Visit:
        return _visit(cluster, machine, wait_s, answer_s)

    return run_parallel(look, machines, connections_at_once(), "doctor")


def _state_problems(cluster: Cluster) -> Iterator[Problem]:
    """Yield what keeps `up` from writing down what it does."""
    folder = state_folder(cluster.spec.cluster)
    nearest = next(path for path in (folder, *folder.parents) if path.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
        advice = "set XDG_STATE_HOME to a folder that can be written"
        yield Problem(f"{nearest}: cannot be written", advice)


def _told(
    what: str, problems: Sequence[Problem], about: str, report: Callable[[str], None]
) -> Sequence[Problem]:
    if not problems:
        report(f"{what}: good" + (f" ({about})" if about else ""))
    for problem in problems:
        said = without_node(problem.what, what)
        report(f"{what}: {said}" + (f"; {problem.advice}" if problem.advice else ""))
        if problem.excerpt:
            report(write_block(problem.excerpt))
    return problems


def _visit(cluster: Cluster, machine: MachineSeen, wait_s: float, answer_s: float) -> Visit:
    """Look at a machine that runs."""
    spec, folder = cluster.spec, machine_folder(cluster.spec.cluster)
    deadline = time.monotonic() + wait_s + answer_s

    def left_s() -> float:
        return max(1.0, min(answer_s, deadline - time.monotonic()))

    try:
        with cluster.access.open(machine, wait_s) as shell:
            probed = probe(shell, spec.cluster, folder, spec.env.python, left_s())
    except CloudError as error:
        return Visit(machine, (Problem(error.problem, error.advice, excerpt=error.excerpt),))
    problems = (
        *_machine_problems(probed),
        *_python_problems(cluster, machine, probed),
        *_install_problems(probed),
    )
    kind = probed.kinds[0][1] if probed.kinds else "no Python"
    return Visit(machine, problems, f"{kind}; {probed.free / (1 << 30):.1f} GiB free")


def _machine_problems(probed: Probed) -> Iterator[Problem]:
    skew = probed.clock - time.time()
    if abs(skew) > MAX_SKEW_S:
        yield Problem(f"its clock is {skew:+.0f} s off", "run a time service there", is_fatal=False)
    if probed.free < MIN_FREE:
        yield Problem(
            f"its disk has {probed.free >> 20} MiB left, {MIN_FREE >> 20} are needed",
            "make room there, or set disk_gb in its profile",
            is_fatal=not probed.installed,
        )


def _python_problems(cluster: Cluster, machine: MachineSeen, probed: Probed) -> Iterator[Problem]:
    """Yield what is missing to install it: an interpreter, or wheels for each of them."""
    spec = cluster.spec
    if spec.provider.is_here:
        return
    if not probed.kinds:
        error = no_python(probed, spec.env.python)
        yield Problem(error.problem, error.advice, is_fatal=not spec.env.setup)
        return
    is_head = machine.name.node == HEAD
    lacking = [
        (kind, missing_wheels(spec, cluster.access.base, kind, is_head=is_head))
        for _, kind in probed.kinds
    ]
    if spec.env.wheelhouse is not None and all(missing for _, missing in lacking):
        kind, missing = lacking[0]
        yield Problem(f"the wheelhouse has no {', '.join(missing)} for {kind}", "add the wheels")


def _install_problems(probed: Probed) -> Iterator[Problem]:
    """Yield what `up` would mend on a machine that it has set up before."""
    if not probed.installed:
        return
    if probed.release == DAMAGED:
        yield Problem("files of what is installed are missing", "run hpcapp up", is_fatal=False)
    elif probed.release != package_version():
        release = f"hpcapp {probed.release}" if probed.release else "no hpcapp"
        yield Problem(f"{release} is installed, not {package_version()}", "run hpcapp up", False)
    elif not probed.is_running:
        yield Problem("its loader does not run", "run hpcapp up; see loader.log", is_fatal=False)
