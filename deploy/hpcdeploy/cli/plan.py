"""The verbs ``validate`` and ``plan``: what a cluster file says, and what it would lead to."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hpccomponent.cli.named_files import json_option
from hpccomponent.cli.terminal import echo, echo_json, visible_line
from hpccomponent.cli.verb import Verb
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CloudError
from hpcdeploy.cli.arguments import FILE

if TYPE_CHECKING:
    from hpcdeploy.provider import Problem
    from hpcdeploy.reconcile.cost import Cost
    from hpcdeploy.reconcile.plan import ClusterPlan
    from hpcdeploy.spec.cluster import ClusterSpec

log = logging.getLogger("hpcapp")


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp validate lab.yaml", "Check a cluster file."),
        ("hpcapp -q validate lab.yaml", "Check it in a script, by the exit code: 0 or 2."),
        ("hpcapp validate lab.yaml --debug", "Show where an error came from."),
    ],
)
@FILE
def validate(file: Path) -> None:
    """Name every mistake in a cluster file; asks no network.

    Warns of what is allowed and hardly meant: an unknown region, SSH open to everybody.
    """
    from hpcdeploy.spec.cluster import read_spec

    spec = read_spec(file)
    _warn(file, spec)
    echo(
        f"{file}: valid: cluster {spec.cluster}, {spec.provider.type}, "
        f"a head and {spec.worker_count} workers"
    )


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp plan lab.yaml", "Show the machines to be made and the cost of an hour."),
        ("hpcapp plan lab.yaml --offline", "The same, by the file alone: no keys are needed."),
        ("hpcapp plan lab.yaml --json", "The same for a program."),
    ],
)
@FILE
@click.option("--offline", is_flag=True, help="Ask no network: the plan of the file alone.")
@json_option("Print one JSON object.")
def plan(file: Path, offline: bool, as_json: bool) -> None:
    """Show what 'up' would do, and what it costs; changes nothing.

    Names the wheels that are missing; refuses what the file's limits forbid. The exit code is 4
    where the cloud or a host cannot be looked at; without keys of the cloud, after what --offline
    shows.
    """
    from hpcdeploy.install.probe import check_this_python
    from hpcdeploy.reconcile.cost import check_limits, estimate_cost
    from hpcdeploy.spec.cluster import read_spec

    spec = read_spec(file)
    _warn(file, spec)
    ahead = _plan_alone(file, spec) if offline else _look(file, spec, as_json)
    ahead.show(as_json)
    check_limits(spec, estimate_cost(spec))
    if spec.provider.is_here:  # other machines would have to be asked
        check_this_python(spec.env.python)
    if hidden := ahead.plan.hidden:
        nodes = ", ".join(machine.name.node for machine in hidden)
        raise CloudError(
            f"{len(hidden)} of {len(spec.nodes())} hosts cannot be looked at: {nodes}",
            f"hpcapp doctor {file} looks closer",
        )


def _warn(file: Path, spec: ClusterSpec) -> None:
    """Warn of what is allowed and hardly meant."""
    from hpcdeploy.spec.checks import find_doubts

    for doubt in dict.fromkeys(find_doubts(spec)):
        log.warning("warning: %s: %s", file, doubt)


@dataclass(frozen=True, slots=True)
class _Ahead:
    """A plan with what is said beside it; `told` is why the cloud was not asked, or empty."""

    path: Path
    spec: ClusterSpec
    plan: ClusterPlan
    told: str = ""
    drift: Sequence[str] = ()
    decided: Sequence[str] = ()
    elsewhere: str = ""

    def show(self, as_json: bool) -> None:
        """Print it for people, or for programs."""
        from hpcdeploy.install.wheels.requirements import check_wheels
        from hpcdeploy.reconcile.cost import estimate_cost

        missing = check_wheels(self.spec, self.path.absolute().parent)
        cost = estimate_cost(self.spec)
        if as_json:
            echo_json(self._as_json(cost, missing))
        else:
            echo("\n".join(map(visible_line, self._lines(cost, missing))))

    def _lines(self, cost: Cost, missing: Sequence[Problem]) -> list[str]:
        from hpcdeploy.reconcile.cost import describe_cost, describe_limits

        planned = [f"would {action}" for action in self.plan.actions] + self.plan.obstacles()
        nothing = f"cluster {self.spec.cluster}: nothing to create or change"
        return [
            *([self.told] if self.told else []),
            *(planned or [nothing]),
            *self.drift,
            *self.decided,
            *describe_cost(cost),
            *describe_limits(self.spec, cost),
            *(f"missing: {problem.what}; {problem.advice}" for problem in missing),
        ]

    def _as_json(self, cost: Cost, missing: Sequence[Problem]) -> dict[str, object]:
        """Return it for programs; money is in dollars, and null where a price is not known."""
        actions = self.plan.actions
        return {
            "cluster": self.spec.cluster,
            "is_looked_up": not self.told,
            "actions": [{"kind": action.kind, "description": str(action)} for action in actions],
            "obstacles": self.plan.obstacles(),
            "decided": list(self.decided),
            "cost": _cost_as_json(cost),
            "missing": [{"what": problem.what, "advice": problem.advice} for problem in missing],
            "drift": list(self.drift),
            "elsewhere": self.elsewhere,
        }


def _look(file: Path, spec: ClusterSpec, as_json: bool) -> _Ahead:
    """Look the cluster up; without keys, show the plan of the file alone before it is refused."""
    from hpcdeploy.reconcile.cluster import describe_elsewhere, open_cluster
    from hpcdeploy.reconcile.converge import look_ahead
    from hpcdeploy.reconcile.drift import describe_drift

    with ExitStack() as stack:
        try:
            cluster = stack.enter_context(open_cluster(file))
        except CloudError:
            _plan_alone(file, spec, "nothing could be looked up, see below").show(as_json)
            raise
        ahead = look_ahead(cluster)
        decided = cluster.provider.decided()
    drift = describe_drift(spec, ahead.kept, file)
    return _Ahead(file, spec, ahead, "", drift, decided, describe_elsewhere(cluster))


def _plan_alone(
    file: Path, spec: ClusterSpec, why: str = "offline: nothing was looked up"
) -> _Ahead:
    """Return the plan of a file where nothing is there yet; no network is asked."""
    from hpcdeploy.provider import Observed
    from hpcdeploy.reconcile.plan import make_plan
    from hpcdeploy.spec.polling import utc_now

    told = f"{why}; from nothing {file} makes this:"
    return _Ahead(file, spec, make_plan(spec, Observed(), utc_now()), told)


def _cost_as_json(cost: Cost) -> dict[str, object]:
    return {
        "hourly": None if cost.unknown else cost.hourly,
        "total_at_most": None if cost.unknown else cost.total_at_most,
        "lease_s": cost.lease_s,
        "priced_as_of": cost.priced_as_of,
        "priced_by": sorted({line.priced_by for line in cost.lines} - {""}),
        "is_estimate": True,
        "no_price_known_of": [line.instance_type for line in cost.unknown],
    }
