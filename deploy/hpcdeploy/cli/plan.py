"""The verbs ``validate`` and ``plan``: what a cluster file says, and what it would lead to."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hpccomponent.terminal import echo, echo_json, visible_line
from hpccomponent.verb import Verb
from hpcdeploy.cli.arguments import FILE

if TYPE_CHECKING:
    from hpcdeploy.provider import Problem
    from hpcdeploy.reconcile.cost import Cost
    from hpcdeploy.reconcile.plan import Plan

__all__ = ["plan", "validate"]


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
    """Name every mistake in a cluster file; asks no network."""
    from hpcdeploy.spec.cluster import read_spec

    spec = read_spec(file)
    echo(
        f"{file}: valid: cluster {spec.cluster}, {spec.provider.type}, "
        f"a head and {spec.worker_count} workers"
    )


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp plan lab.yaml", "Show the machines to be made and the cost of an hour."),
        ("hpcapp plan lab.yaml --json", "The same for a program."),
        ("hpcapp -v plan lab.yaml", "Say what is asked of the cloud meanwhile."),
    ],
)
@FILE
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def plan(file: Path, as_json: bool) -> None:
    """Show what 'up' would do, and what it costs; changes nothing.

    Names the wheels that are missing; refuses what the file's limits forbid.
    """
    from hpcdeploy.install.probe import check_this_python
    from hpcdeploy.install.wheels.requirements import check_wheels
    from hpcdeploy.reconcile.cluster import describe_elsewhere, open_cluster
    from hpcdeploy.reconcile.converge import look_ahead
    from hpcdeploy.reconcile.cost import check_limits, estimate_cost
    from hpcdeploy.reconcile.drift import describe_drift

    with open_cluster(file) as cluster:
        ahead = look_ahead(cluster)
        decided = cluster.provider.decided()
    spec = cluster.spec
    drift, elsewhere = describe_drift(spec, ahead.kept, file), describe_elsewhere(cluster)
    missing = check_wheels(spec, file.absolute().parent)
    cost = estimate_cost(spec)
    if as_json:
        report = _as_json(spec.cluster, ahead, cost, missing, decided)
        echo_json(report | {"drift": drift, "elsewhere": elsewhere})
    else:
        lines = _lines(spec.cluster, ahead, cost, missing, [*drift, *decided])
        echo("\n".join(map(visible_line, lines)))
    check_limits(spec, cost)
    if spec.provider.is_here:  # other machines would have to be asked
        check_this_python(spec.env.python)


def _lines(
    name: str, ahead: Plan, cost: Cost, missing: Sequence[Problem], remarks: Sequence[str]
) -> list[str]:
    """Write a plan for people."""
    from hpcdeploy.reconcile.cost import describe_cost

    planned = [*(f"would {action}" for action in ahead.actions), *ahead.obstacles()]
    return [
        *(planned or [f"cluster {name}: nothing to create or change"]),
        *remarks,
        *describe_cost(cost),
        *(f"missing: {problem.what}; {problem.advice}" for problem in missing),
    ]


def _as_json(
    name: str, ahead: Plan, cost: Cost, missing: Sequence[Problem], decided: Sequence[str]
) -> dict[str, object]:
    """Write a plan for programs; money is in dollars, and null where a price is not known."""
    return {
        "cluster": name,
        "actions": [{"kind": action.kind, "description": str(action)} for action in ahead.actions],
        "obstacles": ahead.obstacles(),
        "decided": list(decided),
        "cost": {
            "hourly": None if cost.unknown else cost.hourly,
            "total_at_most": None if cost.unknown else cost.total_at_most,
            "lease_s": cost.lease_s,
            "priced_as_of": cost.priced_as_of,
            "is_estimate": True,
            "no_price_known_of": [line.instance_type for line in cost.unknown],
        },
        "missing": [{"what": problem.what, "advice": problem.advice} for problem in missing],
    }
