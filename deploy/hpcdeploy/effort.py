"""One run of `up`: from a plan to machines that are set up, with replacements for those that fail.

Used by `converge` only.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from datetime import timedelta
from typing import TYPE_CHECKING

from hpccomponent.errors import CapacityError, CloudError, write_block
from hpcdeploy.cluster import node_order
from hpcdeploy.journal import Journal
from hpcdeploy.launching import launch_nodes
from hpcdeploy.names import HEAD, draw_incarnation
from hpcdeploy.pace import Pace
from hpcdeploy.plan import (
    LIVE,
    Action,
    Allow,
    CreateGroup,
    CreateKeyPair,
    Extend,
    LaunchNode,
    Plan,
    Terminate,
    make_plan,
)
from hpcdeploy.provider import GroupSeen, MachineSeen, Observed, State
from hpcdeploy.removal import remove
from hpcdeploy.ssh_networks import ssh_networks

if TYPE_CHECKING:
    from hpcdeploy.cluster import Cluster

__all__ = ["Effort", "Report", "remove_all"]

Report = Callable[[str], None]
CONSOLE_LINES = 5
Failed = tuple[MachineSeen, str]


class Effort:
    """One run of `up`: what it has launched, what it has given up."""

    def __init__(
        self,
        cluster: Cluster,
        journal: Journal,
        report: Report,
        pace: Pace,
        only_replace: bool = False,
    ) -> None:
        self._cluster, self._spec, self._provider = cluster, cluster.spec, cluster.provider
        self._journal, self._report, self._pace = journal, report, pace
        self._only_replace = only_replace
        self._is_unsettled = self._provider.makes_machines and bool(journal.unfinished())
        self._ssh_from = frozenset[str]() if only_replace else ssh_networks(self._spec)
        self._incarnation = draw_incarnation(pace.now())
        self._group: GroupSeen | None = None
        self._launched: dict[str, MachineSeen] = {}
        self._bad = set(journal.known_bad)
        self._given_up: dict[str, CloudError] = {}
        nodes = len(self._spec.nodes())
        self._replacements = 2 + nodes // 4 if self._provider.makes_machines else 0
        self._deadline = pace.now() + timedelta(seconds=pace.total_s)

    def converge(self) -> None:
        """Go round until every node is set up or given up; see the module's diagram."""
        if self._is_unsettled:
            self._pace.sleep(self._pace.settle_s)
        plan = self._plan()
        if self._only_replace and not plan.actions and not self._is_unsettled:
            return
        while True:
            awaited = self._carry_out(plan)
            self._check_enough()
            running, failed = self._await_running(awaited)
            failed = failed or self._set_up(running)
            for machine, reason in failed:
                self._dismiss(machine, reason)
            self._check_enough()
            plan = self._plan()
            if not failed and self._is_settled(plan):
                break
        for node, error in self._given_up.items():
            self._report(f"going without {node}: {error.problem}")

    def _is_settled(self, plan: Plan) -> bool:
        """Tell whether all are there and nobody else: some are lost or listed only by now."""
        is_late = self._pace.now() >= self._deadline
        return is_late or not any(isinstance(a, LaunchNode | Terminate) for a in plan.actions)

    def undo(self, before: frozenset[str]) -> None:
        """Take away what was made since, or all where no machine was there before."""
        self._report("taking away again what was made")
        if not before:
            remove_all(self._cluster, self._journal, self._report, self._pace)
            return
        if any(not isinstance(error, CapacityError) for error in self._given_up.values()):
            self._pace.sleep(self._pace.settle_s)  # an answer may be lost, its machine not listed

        def made() -> Observed:
            return Observed(tuple(m for m in self._observe().machines if m.id not in before))

        remove(self._provider, made, self._journal.step, self._report, self._pace)

    def _observe(self) -> Observed:
        """Look at the cloud; what was launched and is not listed yet is pending."""
        seen = self._provider.observe(self._spec.cluster)
        listed = {machine.id for machine in seen.machines}
        unlisted = tuple(m for m in self._launched.values() if m.id not in listed)
        return replace(seen, machines=seen.machines + unlisted)

    def _plan(self) -> Plan:
        observed = self._observe()
        self._group = next((g for g in observed.groups if g.cluster == self._spec.cluster), None)
        plan = make_plan(
            self._spec,
            observed,
            self._pace.now(),
            self._incarnation,
            self._ssh_from,
            frozenset(self._bad),
        )
        if self._only_replace and all(machine.name.node != HEAD for machine in plan.kept):
            raise CloudError(
                f"the head of cluster {self._spec.cluster} does not run",
                f"run hpcapp up {self._cluster.path}",
            )
        return replace(plan, actions=tuple(a for a in plan.actions if self._is_due(a)))

    def _is_due(self, action: Action) -> bool:
        if isinstance(action, LaunchNode):
            return action.name.node not in self._given_up
        if isinstance(action, Terminate) and self._only_replace:
            return all(machine.id in self._bad for machine in action.machines)
        return not self._only_replace

    def _carry_out(self, plan: Plan) -> list[MachineSeen]:
        """Do what was planned; return the machines that are to run."""
        kept = {machine.id: machine for machine in plan.kept}
        launches = [action for action in plan.actions if isinstance(action, LaunchNode)]
        for action in plan.actions:
            if isinstance(action, LaunchNode):
                continue
            self._report(str(action))
            with self._journal.step(str(action)):
                self._call(action)
            if isinstance(action, Extend):
                for machine in action.machines:
                    kept[machine.id] = replace(machine, lease_until=action.lease_until)
        launched, short = launch_nodes(
            self._spec,
            self._provider,
            self._journal,
            launches,
            self._group.incarnation if self._group else plan.incarnation,
            self._report,
            self._pace,
        )
        self._launched.update((machine.id, machine) for machine in launched)
        self._given_up.update((shortage.node, shortage.error) for shortage in short)
        running = [m for m in kept.values() if m.name.node not in self._given_up]
        return sorted([*running, *launched], key=node_order)

    def _call(self, action: Action) -> None:
        """Make the provider's call for an action."""
        match action:
            case CreateGroup(incarnation):
                self._group = self._provider.create_group(self._spec.cluster, incarnation)
            case Allow(ssh_from, internal_ports):
                assert self._group is not None  # noqa: S101 - planned only where there is one
                self._provider.allow(self._group, ssh_from, internal_ports)
            case CreateKeyPair():
                assert self._group is not None  # noqa: S101 - planned only where there is one
                life, key = self._group.incarnation, self._cluster.access.public_key()
                self._provider.create_key_pair(self._spec.cluster, life, key)
            case Terminate(machines):
                self._provider.terminate(machines)
            case Extend(machines, lease_until):
                self._provider.extend(machines, lease_until)

    def _await_running(self, awaited: list[MachineSeen]) -> tuple[list[MachineSeen], list[Failed]]:
        """Wait until machines run and have an address; tell which do not, and why."""
        for _ in self._pace.looks(self._spec.limits.boot):
            if all(_is_ready(machine) or machine.state not in LIVE for machine in awaited):
                break
            seen = {machine.id: machine for machine in self._observe().machines}
            awaited = [seen.get(machine.id, machine) for machine in awaited]
        failed = [(m, self._why_not_running(m)) for m in awaited if not _is_ready(m)]
        return [machine for machine in awaited if _is_ready(machine)], failed

    def _why_not_running(self, machine: MachineSeen) -> str:
        said = f" ({machine.reason})" if machine.reason else ""
        if machine.state not in LIVE:
            return f"it ended while it booted{said}"
        with suppress(CloudError):
            end = [line for line in self._provider.console(machine).splitlines() if line.strip()]
            if end:
                block = write_block("\n".join(line[:200] for line in end[-CONSOLE_LINES:]))
                self._report(f"{machine.name.node}: its console ends so:\n{block}")
        return f"not running after {self._spec.limits.boot:.0f} s{said}"

    def _set_up(self, running: list[MachineSeen]) -> list[Failed]:
        """Set the machines up; tell which failed, as the cloud sees them now."""
        from hpcdeploy.bootstrap import set_up  # it imports paramiko, which is slow

        with self._journal.step("set up " + ", ".join(m.name.node for m in running)):
            failures = set_up(self._spec, running, self._cluster.access, self._report)
        if not failures:
            return []
        seen = {machine.id: machine for machine in self._observe().machines}
        return [(seen.get(f.machine.id, f.machine), f.reason) for f in failures]

    def _dismiss(self, machine: MachineSeen, reason: str) -> None:
        """Decide whether a machine that failed is replaced; the next plan carries it out."""
        is_preempted = machine.market == "spot" and machine.state not in LIVE
        if not is_preempted:
            self._bad.add(machine.id)
            if self._provider.makes_machines:  # another machine will have another id
                self._journal.note_bad(machine.id, reason)
        may_go_on = self._pace.now() < self._deadline and (is_preempted or self._replacements > 0)
        node = machine.name.node
        if may_go_on:
            self._replacements -= not is_preempted
            self._report(f"{node}: {reason}; replacing it")
        else:
            advice = f"look at hpcapp doctor {self._cluster.path}, or try another image or type"
            self._given_up[node] = CloudError(reason, advice)

    def _check_enough(self) -> None:
        """Fail where the nodes that are left make no cluster."""
        lost = self._given_up
        workers = self._spec.worker_count - len(lost.keys() - {HEAD})
        if HEAD in lost or (workers < self._spec.worker_min and not self._only_replace):
            node = HEAD if HEAD in lost else min(lost)
            others = f" (and {len(lost) - 1} more)" if len(lost) > 1 else ""
            raise CloudError(
                f"{node}{others} cannot be had: {lost[node].problem}", lost[node].advice
            )


def remove_all(cluster: Cluster, journal: Journal, report: Report, pace: Pace) -> None:
    """Take away all that the cloud lists of a cluster; LeftoverError where something is left."""
    name = cluster.spec.cluster
    remove(
        cluster.provider,
        lambda: cluster.provider.observe(name),
        journal.step,
        report,
        pace,
        quiet_looks=3 if journal.unfinished() else 1,
    )


def _is_ready(machine: MachineSeen) -> bool:
    has_address = bool(machine.public_address or machine.private_address)
    return machine.state is State.RUNNING and has_address
