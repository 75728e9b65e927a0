"""One run of `up`: from a plan to machines that are set up, with replacements for those that fail.

Used by `converge` only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from datetime import timedelta
from typing import TYPE_CHECKING

from hpccomponent.cli.terminal import write_block
from hpccomponent.errors import CapacityError, CloudError
from hpcdeploy.ownership.journal import Journal
from hpcdeploy.ownership.ownership import ours
from hpcdeploy.provider import MachineSeen, Observed, Prerequisites, State, Step, Tags
from hpcdeploy.providers.clouds import places_of
from hpcdeploy.reconcile.cluster import as_desired, node_order, require_ours
from hpcdeploy.reconcile.launching import Launcher
from hpcdeploy.reconcile.plan import (
    LIVE,
    Action,
    ClusterPlan,
    Extend,
    LaunchNode,
    Mark,
    SetWorkers,
    Terminate,
    make_plan,
)
from hpcdeploy.reconcile.removal import remove
from hpcdeploy.reconcile.termination import Proof, Reason, end, may_terminate
from hpcdeploy.spec.names import (
    HEAD,
    Desired,
    NodeName,
    Owner,
    draw_incarnation,
    without_node,
)
from hpcdeploy.spec.polling import Polling
from hpcdeploy.spec.ssh_networks import ssh_networks

if TYPE_CHECKING:
    from hpcdeploy.reconcile.cluster import Cluster
    from hpcdeploy.spec.cluster import ClusterSpec


Report = Callable[[str], None]
CONSOLE_LINES = 5
Failed = tuple[MachineSeen, str]


class Reconciler:
    """One run of `up`: what it has launched, what it has given up."""

    def __init__(
        self,
        cluster: Cluster,
        journal: Journal,
        report: Report,
        polling: Polling,
        only_replace: bool = False,
    ) -> None:
        self._cluster, self._spec, self._provider = cluster, cluster.spec, cluster.provider
        self._nodes = self._spec.nodes()
        self._desired: Desired | None = None
        self._before: Desired | None = None
        self._has_set_workers = False
        self._journal, self._report, self._polling = journal, report, polling
        self._only_replace = only_replace
        self._is_unsettled = self._provider.makes_machines and bool(journal.unfinished())
        self._ssh_from = frozenset[str]() if only_replace else ssh_networks(self._spec)
        self._incarnation = draw_incarnation(polling.now())
        self._life = ""
        self._owner = Owner()
        self._seen = Observed()
        self._unlisted: dict[str, MachineSeen] = {}
        self._given_up: dict[str, CloudError] = {}
        self._has_begun = False
        nodes = len(self._spec.nodes())
        self._replacements = 2 + nodes // 4 if self._provider.makes_machines else 0
        self._deadline = polling.now() + timedelta(seconds=polling.total_s)

    @property
    def spec(self) -> ClusterSpec:
        """The file, with the number of workers that was asked for last."""
        return self._spec

    def first_plan(self) -> ClusterPlan:
        """Return what is to be done, once the cloud lists what an earlier command asked for."""
        if self._is_unsettled:
            self._polling.sleep(self._polling.settle_s)
        return self.plan()

    def converge(self, plan: ClusterPlan) -> None:
        """Go round until every node is set up or given up; see the module's diagram."""
        if self._only_replace and not plan.actions and not self._is_unsettled:
            return
        self._try_head(plan)
        while True:
            self._check_enough()
            awaited = self._carry_out(plan)
            self._check_enough()
            running, failed = self._await_running(awaited)
            failed = failed or self._set_up(running)
            if failed:
                self._follow(self._observe())
            for machine, reason in failed:
                if machine.name.node in self._spec.nodes():
                    self._dismiss(machine, reason)
            workers = self._spec.worker_count
            plan = self.plan()
            if not failed and self._is_settled(plan) and workers == self._spec.worker_count:
                break
        for node, error in self._lost().items():
            self._report(f"going without {node}: {error.problem}")

    def _try_head(self, plan: ClusterPlan) -> None:
        """Log in to a head that was at work before workers are launched for it.

        A cloud lists as running what hangs or has lost its network, too.
        """
        if not any(isinstance(action, LaunchNode) for action in plan.actions):
            return
        heads = (m for m in plan.kept if m.name.node == HEAD and m.state is State.RUNNING)
        for head in filter(self._may_be_at_work, heads):
            try:
                self._cluster.access.open(head).close()
            except CloudError as error:
                if error.excerpt:
                    self._report(f"{HEAD}:\n{write_block(error.excerpt)}")
                self._dismiss(head, without_node(str(error), HEAD))

    def _is_settled(self, plan: ClusterPlan) -> bool:
        """Tell whether all are there and nobody else: some are lost or listed only by now."""
        is_late = self._polling.now() >= self._deadline
        return is_late or not any(isinstance(a, LaunchNode | Terminate) for a in plan.actions)

    def undo(self, reason: str) -> None:
        """Take away the machines that this command has launched, and what is empty without them.

        `reason` is one line.
        """
        if not self._has_begun:
            return
        self._report(f"taking away again what was made: {reason}")
        is_slow = self._provider.makes_machines  # clouds list with a delay
        errors = self._given_up.values()
        if is_slow and any(not isinstance(error, CapacityError) for error in errors):
            # an answer may be lost, its machine not listed
            self._polling.sleep(self._polling.settle_s)

        def made() -> tuple[Observed, Proof]:
            seen = self._observe()
            proof = self._proof(seen)
            going = tuple(m for m in seen.machines if may_terminate(m, Reason.ROLL_BACK, proof))
            others = [m for m in seen.machines if m not in going and m.state is not State.GONE]
            if others or not self._is_ours(seen):
                return Observed(going), proof
            return Observed(going, seen.resources), proof

        looks = 3 if is_slow and self._journal.unfinished() else 1
        args = (Reason.ROLL_BACK, self._journal.step, self._report, self._polling, looks)
        try:
            self._take_back()
        finally:
            remove(self._provider, made, *args)
        if all(machine.state is State.GONE for machine in self._observe().machines):
            self._journal.clear_places(places_of(self._spec))

    def _is_ours(self, seen: Observed) -> bool:
        try:
            require_ours(self._cluster, seen, self._polling.now())
        except CloudError:
            return False
        return True

    def _follow(self, seen: Observed) -> None:
        """Go by the number of workers that was asked for last, by whichever command.

        The number of this very command is the last one until a later one is seen: a cloud may
        list an earlier one for a while.
        """
        desired = seen.desired(self._spec.cluster)
        if desired is None or (self._desired is None and not self._only_replace):
            return
        if self._desired is not None and desired.revision < self._desired.revision:
            return
        self._desired = desired
        present = replace(self._cluster, spec=self._spec)
        self._spec = as_desired(present, seen, self._report).spec

    def _take_back(self) -> None:
        """Want no more workers than before this command; but who asked for fewer still does."""
        said, before = self._desired, self._before
        if said is None or before is None or before.workers >= said.workers:
            return
        seen = self._observe()
        latest = seen.desired(self._spec.cluster) or said
        if latest.revision >= said.revision and latest != said:
            return  # another command has the last word
        heads = [m for m in seen.machines if m.name.node == HEAD and m.state in LIVE]
        if heads:  # who watches would launch them again
            earlier = Desired(said.revision + 1, before.workers)
            with self._journal.step(f"set the number of workers to {before.workers}"):
                self._provider.tag(heads[:1], Tags(desired=earlier))

    def _proof(self, seen: Observed) -> Proof:
        """Return what may be ended of what is seen: ours, and what of it nobody can be using."""
        ownership = self._cluster.access.ownership()
        own_machines = ours(seen, ownership)
        if not self._spec.provider.is_shared:
            own_machines = frozenset(machine.id for machine in seen.machines)
        launched = self._launched(seen.machines, since_opened=True)
        return Proof(own_machines, self._launched(seen.machines) - self._journal.used, launched)

    def _launched(
        self, machines: Iterable[MachineSeen], *, since_opened: bool = False
    ) -> frozenset[str]:
        """Return the ids of the machines that were launched from here and that nobody else uses.

        Who shares our key may have launched the very same node: it bears their name. Or they have
        begun to set up what we have launched, which our journal cannot tell.
        """
        users = (self._cluster.access.ownership().owner.user, "")
        asked = self._journal.launched(since_opened=since_opened)
        return frozenset(
            m.id
            for m in machines
            if (m.incarnation, m.name) in asked and m.owner.user in users and not m.set_up_by
        )

    def _observe(self) -> Observed:
        """Look at the cloud; what was launched and was never listed is pending.

        Fixed machines are listed at once, and what was listed once and is not any more is gone.
        """
        seen = self._provider.observe(self._spec.cluster)
        for machine in seen.machines:
            self._unlisted.pop(machine.id, None)
        unlisted = tuple(self._unlisted.values()) if self._provider.makes_machines else ()
        return replace(seen, machines=seen.machines + unlisted)

    def plan(self) -> ClusterPlan:
        """Look at the cloud, and return what is to be done now; nothing is changed."""
        observed = self._seen = self._observe()
        require_ours(self._cluster, observed, self._polling.now())
        self._follow(observed)
        plan = make_plan(
            self._spec,
            observed,
            self._polling.now(),
            self._incarnation,
            lambda life: self._provider.prepare(self._wanted(life), observed),
            self._journal.known_bad & self._proof(observed).unused,
            self._cluster.access.ownership().owner,
            self._desired,
        )
        self._life = plan.incarnation
        if self._desired is None and not self._only_replace:
            self._desired, kept = plan.desired, [machine.name.node for machine in plan.kept]
            if HEAD in kept:
                before = observed.desired(self._spec.cluster)
                self._before = before or Desired(0, len(kept) - 1)
        for machine in plan.hidden:
            if machine.name.node not in self._spec.nodes():
                continue
            reason = machine.reason or "it does not let us see what it does"
            self._give_up(machine, f"{reason}; it stays as it is")
        if self._only_replace and all(machine.name.node != HEAD for machine in plan.kept):
            raise CloudError(
                f"the head of cluster {self._spec.cluster} does not run",
                f"run hpcapp up {self._cluster.path}",
            )
        due = (self._due(action) for action in plan.actions)
        return replace(plan, actions=tuple(action for action in due if action is not None))

    def _wanted(self, life: str) -> Prerequisites:
        ports = frozenset({self._spec.communicator.port})
        return Prerequisites(self._spec.cluster, life, self._ssh_from, ports)

    def _due(self, action: Action) -> Action | None:
        """Return what of an action is this command's to do."""
        match action:
            case LaunchNode(NodeName(node)):
                # What a later command asks for beyond this one is that command's to launch.
                is_asked = self._only_replace or node in self._nodes
                return action if is_asked and node not in self._given_up else None
            case Terminate(machines, Reason.UNWANTED) if self._only_replace:
                launched = self._proof(self._seen).launched
                late = tuple(machine for machine in machines if machine.id in launched)
                return Terminate(late, Reason.UNWANTED) if late else None
            case Terminate(_, why) if self._only_replace:
                return action if why is Reason.UNUSABLE else None
            case SetWorkers() if self._has_set_workers:
                return None  # the cloud lists it late, or has another command's by now
        return None if self._only_replace else action

    def _carry_out(self, plan: ClusterPlan) -> list[MachineSeen]:
        """Do what was planned; return the machines that are to run."""
        if plan.actions:
            self._owner = self._cluster.access.owner()
            nodes = self._spec.nodes()
            hosts = {host.id for host in self._provider.hosts() if host.name.node in nodes}
            self._journal.note_places(places_of(self._spec, hosts))
        kept = {machine.id: machine for machine in plan.kept}
        launches = [action for action in plan.actions if isinstance(action, LaunchNode)]
        steps = (action for action in plan.actions if isinstance(action, Step))
        self._has_begun |= bool(launches) or any(step.makes for step in steps)
        for action in plan.actions:
            if isinstance(action, LaunchNode):
                continue
            self._report(str(action))
            begins = action.begins if isinstance(action, Step) else ""
            life = {"incarnation": begins} if begins else {}
            with self._journal.step(str(action), **life):
                self._call(action)
            if isinstance(action, Extend):
                for machine in action.machines:
                    kept[machine.id] = replace(machine, lease_until=action.lease_until)
        launcher = Launcher(
            self._spec,
            self._provider,
            self._journal,
            self._report,
            self._polling,
            self._life,
            self._owner,
        )
        launched, short = launcher.launch_all(launches)
        self._unlisted.update((machine.id, machine) for machine in launched)
        self._given_up.update(short)
        running = [m for m in kept.values() if m.name.node not in self._given_up]
        return sorted([*running, *launched], key=node_order)

    def _call(self, action: Action) -> None:
        """Make the provider's call for an action."""
        match action:
            case Step():
                self._life = action.carry_out(self._cluster.access)
                if action.begins not in ("", self._life):  # another hurried user was first
                    require_ours(self._cluster, self._observe(), self._polling.now())
            case Mark(machines, resources, owner):
                self._provider.tag(machines, Tags(owner), resources)
            case SetWorkers(head, desired):
                self._provider.tag([head], Tags(desired=desired))
                self._has_set_workers = True
            case Terminate(machines, why):
                end(self._provider, machines, why, self._proof(self._seen))
                if self._spec.provider.fixed_hosts:
                    ended = {machine.id for machine in machines}
                    self._journal.clear_places(places_of(self._spec, ended))
            case Extend(machines, lease_until):
                self._provider.tag(machines, Tags(lease_until=lease_until))

    def _await_running(self, awaited: list[MachineSeen]) -> tuple[list[MachineSeen], list[Failed]]:
        """Wait until machines run and have an address; tell which do not, and why."""
        kind = self._spec.provider.address_kind
        limit_s = self._spec.limits.boot
        for look, _ in enumerate(self._polling.looks(limit_s)):
            late = [m for m in awaited if not _is_ready(m, kind) and m.state in LIVE]
            if not late:
                break
            if look == 0:
                names = ", ".join(machine.name.node for machine in late)
                self._report(f"waiting until {names} run, {limit_s:.0f} s at most")
            seen = {machine.id: machine for machine in self._observe().machines}
            awaited = [seen.get(machine.id, machine) for machine in awaited]
        failed = [(m, self._why_not_running(m)) for m in awaited if not _is_ready(m, kind)]
        return [machine for machine in awaited if _is_ready(machine, kind)], failed

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
        from hpcdeploy.install.bootstrap import set_up  # it imports paramiko, which is slow

        self._journal.note_set_up((m.id for m in running), is_done=False)
        launched = self._launched(running)
        others = [m for m in running if m.id not in launched and not m.set_up_by]
        if others:  # so that who has launched them does not take them for unused
            self._provider.tag(others, Tags(set_up_by=self._cluster.access.ownership().owner.user))
        with self._journal.step("set up " + ", ".join(m.name.node for m in running)):
            reasons = set_up(self._spec, running, self._cluster.access, self._report)
        self._journal.note_set_up((m.id for m in running if m.id not in reasons), is_done=True)
        if not reasons:
            return []
        seen = {machine.id: machine for machine in self._observe().machines}
        return [(seen.get(m.id, m), reasons[m.id]) for m in running if m.id in reasons]

    def _dismiss(self, machine: MachineSeen, reason: str) -> None:
        """Decide whether a machine that failed is replaced; the next plan carries it out."""
        is_preempted = machine.market == "spot" and machine.state not in LIVE
        if self._may_be_at_work(machine):
            self._give_up(
                machine, f"{reason}; it stays, for it may be at work", self._ways_on(machine)
            )
            return
        if self._provider.makes_machines and not is_preempted:  # hosts have no other id
            self._journal.note_bad(machine.id, reason)
        may_go_on = self._polling.now() < self._deadline and (
            is_preempted or self._replacements > 0
        )
        if may_go_on:
            self._replacements -= not is_preempted
            self._report(f"{machine.name.node}: {reason}; replacing it")
        else:
            self._give_up(machine, reason)

    def _may_be_at_work(self, machine: MachineSeen) -> bool:
        """Tell whether a cloud's machine lives and was ever set up, as far as we know."""
        proof = self._proof(Observed((machine,)))
        is_new = machine.id in proof.unused | (proof.launched - self._journal.set_up)
        return self._provider.makes_machines and machine.state in LIVE and not is_new

    def _ways_on(self, machine: MachineSeen) -> str:
        """Say what helps against a machine that was at work and cannot be set up any more."""
        file = self._cluster.path
        return (
            f"mend it (hpcapp ssh {file} {machine.name.node}); where it lets nobody in, end "
            f"{machine.id} in the cloud's console and run hpcapp up {file}, or begin anew: "
            f"hpcapp down {file} ends all machines, with what runs on them"
        )

    def _give_up(self, machine: MachineSeen, reason: str, advice: str = "") -> None:
        others = ", or try another image or type" if self._provider.makes_machines else ""
        doctor = f"look at hpcapp doctor {self._cluster.path}{others}"
        self._given_up[machine.name.node] = CloudError(reason, advice or doctor)

    def _lost(self) -> dict[str, CloudError]:
        """Return why nodes were given up, of those that are still wanted."""
        wanted = self._spec.nodes()
        return {node: error for node, error in self._given_up.items() if node in wanted}

    def _check_enough(self) -> None:
        """Fail where the nodes that are left make no cluster."""
        lost = self._lost()
        workers = self._spec.worker_count - len(lost.keys() - {HEAD})
        if HEAD in lost or (workers < self._spec.worker_min and not self._only_replace):
            node = HEAD if HEAD in lost else min(lost)
            others = f" (and {len(lost) - 1} more)" if len(lost) > 1 else ""
            raise CloudError(
                f"{node}{others} cannot be had: {lost[node].problem}", lost[node].advice
            )


def _is_ready(machine: MachineSeen, kind: str) -> bool:
    return machine.state is State.RUNNING and bool(machine.address(kind))
