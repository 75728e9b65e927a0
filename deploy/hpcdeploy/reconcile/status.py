"""What is known of a cluster: its machines from the cloud, their loaders from themselves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, TypedDict

from hpccomponent.cli.terminal import align_rows
from hpccomponent.errors import CloudError, HpcError
from hpccomponent.units import write_duration
from hpcdeploy.install.loader_service import is_running_command
from hpcdeploy.install.probe import RELEASE_COMMAND
from hpcdeploy.login.parallel import connections_at_once, run_parallel
from hpcdeploy.login.shell import Shell
from hpcdeploy.provider import MachineSeen, Observed, State
from hpcdeploy.reconcile.cluster import describe_elsewhere, node_order, require_ours
from hpcdeploy.reconcile.cost import price_machines, write_dollars
from hpcdeploy.reconcile.plan import LIVE
from hpcdeploy.spec.layout import machine_folder
from hpcdeploy.spec.names import HEAD, without_node
from hpcdeploy.spec.polling import utc_now

if TYPE_CHECKING:
    from hpcdeploy.reconcile.cluster import Cluster
    from hpcdeploy.spec.provider import CloudSpec


class MachineStatus(TypedDict):
    """A machine as JSON has it; its loader is null where it was not asked."""

    node: str
    generation: int
    id: str
    state: str
    reason: str
    owner: str
    instance_type: str
    market: str
    public_address: str
    private_address: str
    age_s: float | None
    lease_left_s: float | None
    loader: str | None


class ClusterStatus(TypedDict):
    """A cluster as JSON has it; nodes are hidden whose machine cannot be looked at.

    `hourly_cost`, of the machines that are there, is in dollars; null where it is not known.
    """

    cluster: str
    provider: str
    made_elsewhere: str
    is_up: bool
    elsewhere: str
    hidden: list[str]
    missing: list[str]
    unwanted: list[str]
    hourly_cost: float | None
    machines: list[MachineStatus]


class ClusterLine(TypedDict):
    """A cluster in a list, as JSON has it; `hourly_cost` as in `ClusterStatus`."""

    cloud: str
    cluster: str
    states: dict[str, int]
    instance_types: list[str]
    hourly_cost: float | None
    lease_left_s: float | None


ANSWER_S = 10.0
"""How long a machine may take to tell about its loader."""


def describe_cluster(cluster: Cluster, ask_machines: bool = True) -> ClusterStatus:
    """Return what is known of a cluster, as JSON takes it.

    With `ask_machines` every machine is asked for its loader, over SSH.
    """
    now = utc_now()
    seen = cluster.provider.observe(cluster.spec.cluster)
    machines = sorted((m for m in seen.machines if m.state is not State.GONE), key=node_order)
    elsewhere = _made_elsewhere(cluster, seen)
    loaders = _ask_loaders(cluster, machines) if ask_machines and not elsewhere else {}
    hidden = {m.id: m.reason for m in machines if m.state is State.UNKNOWN}
    rows = [_machine(m, now, (loaders | hidden).get(m.id)) for m in machines]
    wanted = cluster.spec.nodes()
    running_nodes = [machine.name.node for machine in machines if machine.state is State.RUNNING]
    unknown = [machine.name.node for machine in machines if machine.state is State.UNKNOWN]
    unseen = [node for node in wanted if node in unknown and node not in running_nodes]
    return {
        "cluster": cluster.spec.cluster,
        "provider": cluster.provider.name,
        "made_elsewhere": elsewhere,
        "is_up": set(wanted) <= set(running_nodes),
        "elsewhere": describe_elsewhere(cluster),
        "hidden": unseen,
        "missing": [node for node in wanted if node not in running_nodes and node not in unseen],
        "unwanted": [node for node in running_nodes if node not in wanted],
        "hourly_cost": _price(cluster.spec.provider.cloud, machines),
        "machines": rows,
    }


def list_clusters(
    where: str, observed: Observed, spec: CloudSpec | None = None
) -> list[ClusterLine]:
    """Return a line for every cluster of a cloud, sorted by the cluster's name.

    The lines call the cloud `where`; `observed` is of all its clusters, and `spec`, the cloud as a
    file has it, for its prices.
    """
    alive = [machine for machine in observed.machines if machine.state is not State.GONE]
    names = {m.cluster for m in alive} | {r.cluster for r in observed.resources}
    now = utc_now()
    rows: list[ClusterLine] = []
    for name in sorted(names):
        machines = [machine for machine in alive if machine.cluster == name]
        leases = [machine.lease_until for machine in machines if machine.lease_until]
        rows.append(
            {
                "cloud": where,
                "cluster": name,
                "states": dict(Counter(map(_state, machines))),
                "instance_types": sorted({m.instance_type for m in machines} - {""}),
                "hourly_cost": _price(spec, machines),
                "lease_left_s": (min(leases) - now).total_seconds() if leases else None,
            }
        )
    return rows


def write_table(status: ClusterStatus) -> str:
    """Write what `describe_cluster` returns for people; columns without a word are left out."""
    lines = [("NODE", "STATE", "TYPE", "MARKET", "PUBLIC", "PRIVATE", "AGE", "LEASE", "LOADER")] + [
        (
            machine["node"],
            machine["state"],
            machine["instance_type"],
            machine["market"] if machine["instance_type"] else "",
            machine["public_address"],
            machine["private_address"],
            _duration(machine["age_s"]),
            _duration(machine["lease_left_s"]),
            without_node(machine["loader"] or machine["reason"], machine["node"]),
        )
        for machine in status["machines"]
    ]
    heads = [f"cluster {status['cluster']} ({status['provider']}): {_verdict(status)}"]
    if status["made_elsewhere"]:
        heads.append(status["made_elsewhere"])
    if status["hourly_cost"]:
        heads.append(f"cost: {write_dollars(status['hourly_cost'])} an hour at most")
    return "\n".join([*heads, *_align_filled(lines)])


def _verdict(status: ClusterStatus) -> str:
    """Say how what runs differs from the file: after `scale`, that is as it was asked for."""
    missing, unwanted, hidden = status["missing"], status["unwanted"], status["hidden"]
    running = sum(machine["state"] == State.RUNNING for machine in status["machines"])
    if not running and not hidden:
        return f"not up, missing: {', '.join(missing)}"
    parts = ["up"]
    if HEAD in missing:
        parts = [f"not up: {HEAD} does not run"]
    elif HEAD in hidden:
        parts = ["not known whether it is up"]
    if hidden:
        parts.append(f"{', '.join(hidden)} cannot be looked at")
    workers = [node for node in missing if node != HEAD]
    if workers:
        parts.append(
            f"without {', '.join(workers)} of the file (hpcapp up launches what is missing)"
        )
    if unwanted:
        parts.append(f"with {', '.join(unwanted)} beyond the file (hpcapp up ends what is beyond)")
    return ", ".join(parts)


def write_list(rows: list[ClusterLine]) -> str:
    """Write what `list_clusters` returns for people."""
    if not rows:
        return "no clusters"
    lines = [("CLUSTER", "CLOUD", "MACHINES", "TYPES", "HOURLY", "LEASE")]
    for row in rows:
        states = ", ".join(f"{count} {state}" for state, count in row["states"].items())
        states = states or "none; hpcapp down or reap removes what is left"
        kinds = ", ".join(row["instance_types"])
        hourly = write_dollars(row["hourly_cost"]) if row["hourly_cost"] else "-"
        left = _duration(row["lease_left_s"])
        lines.append((row["cluster"], row["cloud"], states, kinds, hourly, left))
    return "\n".join(_align_filled(lines))


def _price(cloud: CloudSpec | None, machines: Iterable[MachineSeen]) -> float | None:
    """Return what those of the machines that may work cost an hour."""
    return price_machines(cloud, (machine for machine in machines if machine.state in LIVE))


def _align_filled(rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Align rows below a heading, without the columns in which nothing stands."""
    columns = [column for column in zip(*rows, strict=True) if set(column[1:]) - {"", "-"}]
    return align_rows(list(zip(*columns, strict=True)))


def _state(machine: MachineSeen) -> str:
    """Return a state in a few words; of one that is not known, why: its reason begins so."""
    if machine.state is State.UNKNOWN:
        return f"{machine.state} ({machine.reason.partition(':')[0]})"
    return str(machine.state)


def _machine(machine: MachineSeen, now: datetime, loader: str | None) -> MachineStatus:
    launched, until = machine.launched, machine.lease_until
    return {
        "node": machine.name.node,
        "generation": machine.name.generation,
        "id": machine.id,
        "state": str(machine.state),
        "reason": machine.reason,
        "owner": machine.owner.user,
        "instance_type": machine.instance_type,
        "market": machine.market,
        "public_address": machine.public_address,
        "private_address": machine.private_address,
        "age_s": (now - launched).total_seconds() if launched else None,
        "lease_left_s": (until - now).total_seconds() if until else None,
        "loader": loader,
    }


def _made_elsewhere(cluster: Cluster, seen: Observed) -> str:
    """Say whose the cluster is, where it is another's."""
    try:
        require_ours(cluster, seen)
    except CloudError as error:
        return error.problem
    return ""


def _ask_loaders(cluster: Cluster, machines: Iterable[MachineSeen]) -> dict[str, str]:
    """Ask every machine that runs, several at once, for its loader."""

    def ask(machine: MachineSeen) -> str:
        try:
            with cluster.access.open(machine, timeout_s=ANSWER_S) as shell:
                return _loader_version(cluster.spec.cluster, shell)
        except HpcError as error:
            return error.problem

    running = [machine for machine in machines if machine.state is State.RUNNING]
    answers = run_parallel(ask, running, connections_at_once(), "status")
    return {machine.id: answer for machine, answer in zip(running, answers, strict=True)}


def _loader_version(cluster: str, shell: Shell) -> str:
    """Return the version of the loader that runs on a machine, or why none does."""
    answer = shell.run(
        f"cd {machine_folder(cluster)} || exit 4; {is_running_command(cluster)} || exit 3; "
        + RELEASE_COMMAND,
        timeout_s=ANSWER_S,
    )
    if answer.exit_code == 3:
        return "not running"
    return answer.output.strip() or "not installed"


def _duration(seconds: float | None) -> str:
    """Write a time that may be over, or not known."""
    if seconds is None:
        return "-"
    return "over" if seconds < 0 else write_duration(seconds)
