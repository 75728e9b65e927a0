"""What stops `up` before it launches anything: what `doctor` and `plan` know to be missing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from hpccomponent.errors import CloudError
from hpcdeploy.provider import Problem
from hpcdeploy.reconcile.cluster import Cluster
from hpcdeploy.reconcile.examination import Visit, visit
from hpcdeploy.reconcile.plan import Action, LaunchNode
from hpcdeploy.spec.names import HEAD, without_node

OVERRIDE = "--skip-checks launches all the same"


def check_ready(
    cluster: Cluster,
    actions: Sequence[Action],
    missing: Sequence[Problem],
    report: Callable[[str], None],
) -> None:
    """Refuse to launch machines that could not be set up; nothing is changed.

    Only where `actions` launch nodes is anything looked at. What is `missing` in the wheelhouse,
    see `requirements.check_wheels`, is said already. Raises CloudError where `up` would fail; it
    says over what.
    """
    nodes = {action.name.node for action in actions if isinstance(action, LaunchNode)}
    if not nodes:
        return
    fatal = [problem for problem in missing if problem.is_fatal]
    for problem in cluster.provider.check():
        report(f"problem: {_line(problem)}")
        fatal += [problem] if problem.is_fatal else []
    if fatal:
        raise _refusal(fatal)
    hosts = [machine for machine in cluster.provider.hosts() if machine.name.node in nodes]
    if hosts:
        _check_hosts(cluster, visit(cluster, hosts), report)


def _check_hosts(cluster: Cluster, visits: Sequence[Visit], report: Callable[[str], None]) -> None:
    """Refuse where the hosts that will do make no cluster."""
    failing = list(_failing(visits, report))
    workers = [problem for node, problem in failing if node != HEAD]
    spare = cluster.spec.worker_count - cluster.spec.worker_min
    if len(workers) < len(failing) or len(workers) > spare:
        raise _refusal([problem for _, problem in failing])


def _failing(
    visits: Sequence[Visit], report: Callable[[str], None]
) -> Iterator[tuple[str, Problem]]:
    for seen in visits:
        node = seen.machine.name.node
        for problem in seen.problems:
            report(f"problem: {node}: {without_node(_line(problem), node)}")
        fatal = next((problem for problem in seen.problems if problem.is_fatal), None)
        if fatal is not None:
            yield node, Problem(f"{node}: {without_node(fatal.what, node)}", fatal.advice)


def _refusal(fatal: Sequence[Problem]) -> CloudError:
    more = f" (and {len(fatal) - 1} more, see above)" if len(fatal) > 1 else ""
    advice = f"{fatal[0].advice}; {OVERRIDE}" if fatal[0].advice else OVERRIDE
    return CloudError(f"nothing is launched: {fatal[0].what}{more}", advice)


def _line(problem: Problem) -> str:
    return f"{problem.what}; {problem.advice}" if problem.advice else problem.what
