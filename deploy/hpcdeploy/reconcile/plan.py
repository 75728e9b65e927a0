"""What to do so that the cloud is as the file says: (spec, observed) -> actions, pure.

Nothing here calls a cloud; `converge` carries the actions out in their order, `plan` prints them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from datetime import datetime, timedelta
from typing import ClassVar

from hpccomponent.dataclass import dataclass
from hpcdeploy.provider import LaunchChoice, MachineSeen, Observed, Resource, State, Step
from hpcdeploy.reconcile.termination import Reason
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.names import HEAD, NOBODY, Desired, NodeName, Owner
from hpcdeploy.spec.provider import Profile

LIVE = (State.PENDING, State.RUNNING)
LEASE_SLACK = 0.1
"""The lease is written anew once this part of it has passed."""


@dataclass(frozen=True, slots=True)
class LaunchNode:
    """Start the machine of a node: `choices` are tried in their order; a head bears `desired`."""

    kind: ClassVar[str] = "LaunchNode"

    name: NodeName
    profile: str
    choices: tuple[LaunchChoice, ...]
    desired: Desired | None = None

    def __str__(self) -> str:
        kinds = _describe_choices(self.choices) if self.choices[0].instance_type else ""
        again = f", generation {self.name.generation}" if self.name.generation > 1 else ""
        return f"launch {self.name.node}{f' as {kinds}' if kinds else ''}{again}"


def _describe_choices(choices: Sequence[LaunchChoice]) -> str:
    """Return in a few words what `launch_choices` has made of types, markets and places."""
    types = " or ".join(dict.fromkeys(choice.instance_type for choice in choices))
    markets = ", else ".join(dict.fromkeys(choice.market for choice in choices))
    places = " or ".join(dict.fromkeys(choice.place for choice in choices if choice.place))
    return f"{types} ({markets}{f', in {places}' if places else ''})"


@dataclass(frozen=True, slots=True)
class Extend:
    """Write a new end of the lease."""

    kind: ClassVar[str] = "Extend"

    machines: tuple[MachineSeen, ...]
    lease_until: datetime

    def __str__(self) -> str:
        nodes = ", ".join(machine.name.node for machine in self.machines)
        return f"extend the lease of {nodes} to {self.lease_until:%Y-%m-%d %H:%M} UTC"


@dataclass(frozen=True, slots=True)
class Terminate:
    """End machines for one reason."""

    kind: ClassVar[str] = "Terminate"

    machines: tuple[MachineSeen, ...]
    why: Reason

    def __str__(self) -> str:
        nodes = ", ".join(f"{machine.name.node} ({machine.id})" for machine in self.machines)
        return f"terminate {nodes}: {self.why}"


@dataclass(frozen=True, slots=True)
class Mark:
    """Write down whose machines and resources are that bear no owner's key yet."""

    kind: ClassVar[str] = "Mark"

    machines: tuple[MachineSeen, ...]
    resources: tuple[Resource, ...]
    owner: Owner

    def __str__(self) -> str:
        names = [m.name.node for m in self.machines] + [r.name for r in self.resources]
        return f"mark {', '.join(names)} as {self.owner.user}'s"


@dataclass(frozen=True, slots=True)
class SetWorkers:
    """Write down how many workers are wanted from now on, before any comes or goes."""

    kind: ClassVar[str] = "SetWorkers"

    head: MachineSeen
    desired: Desired

    def __str__(self) -> str:
        return f"set the number of workers to {self.desired.workers}"


Action = Step | Mark | SetWorkers | Terminate | Extend | LaunchNode


@dataclass(frozen=True, slots=True)
class ClusterPlan:
    """What to do: actions in their order, none where nothing is to be done.

    Machines that are `kept` stay; new ones belong to the life `incarnation` of the cluster. Of
    those that are `hidden` nothing can be said, and why: each counts as its node's, and stays.
    `desired` is how many workers there are to be once it is carried out.
    """

    actions: tuple[Action, ...] = ()
    kept: tuple[MachineSeen, ...] = ()
    incarnation: str = ""
    hidden: tuple[MachineSeen, ...] = ()
    desired: Desired | None = None

    def beyond(self, agreed: ClusterPlan) -> list[str]:
        """Say what would be done that a plan the user has agreed to does not contain.

        The end of the lease does not count: each `up` begins it anew, whenever it comes to that.
        """
        known = {step for action in agreed.actions for step in _steps(action)}
        return [str(action) for action in self.actions if not known.issuperset(_steps(action))]

    def obstacles(self) -> list[str]:
        """Say what stands in the way of machines that do not let us see what they do."""
        return [f"{m.name.node} ({m.id}) cannot be looked at: {m.reason}" for m in self.hidden]


def _steps(action: Action) -> set[tuple[str, ...]]:
    """Return what tells an action from others, one entry for each machine that it is about."""
    match action:
        case Extend():
            return set()
        case Terminate(machines, why):
            return {("terminate", machine.id, why) for machine in machines}
        case Mark(machines, resources):
            ids = [machine.id for machine in machines] + [life.id for life in resources]
            return {("mark", id_) for id_ in ids}
        case LaunchNode(NodeName(node), _, choices):
            return {("launch", node, *map(str, choices))}
    return {(str(action),)}


def launch_choices(
    profile: Profile | None, has_spot: bool = True, subnets: tuple[str, ...] = ()
) -> tuple[LaunchChoice, ...]:
    """Return instance types, markets and places, in the order in which they are tried; never none.

    All places are tried for a type before the next type, and all types for a market before the next
    market: what is cheapest first. Without `has_spot` a fallback is all there is. Each of
    `subnets`, of the cluster file, lies in a zone, so that several take the place of zones.
    """
    if profile is None:
        return (LaunchChoice("", "on_demand"),)
    several = next((places for places in (subnets, profile.zones) if len(places) > 1), ("",))
    fallback = ("spot", "on_demand") if has_spot else ("on_demand",)
    markets = {"spot_with_fallback": fallback}.get(profile.market, (profile.market,))
    return tuple(
        LaunchChoice(kind, market, place)
        for market in markets
        for kind in profile.instance_types
        for place in several
    )


def make_plan(
    spec: ClusterSpec,
    observed: Observed,
    now: datetime,
    incarnation: str = "",
    prepare: Callable[[str], Sequence[Step]] = lambda _: (),
    known_bad: frozenset[str] = frozenset(),
    owner: Owner = NOBODY,
    known: Desired | None = None,
) -> ClusterPlan:
    """Compare what is wanted with what is there; what belongs to other clusters does not matter.

    `incarnation` is for a new life of the cluster, see `names.draw_incarnation`. `prepare` returns
    what must still be done for a life before machines are launched, see `Provider.prepare`.
    Machines with an id in `known_bad` are to be replaced. `owner` is us, for what is ours and bears
    no key of an owner; without a key nothing is marked. `known` is the number of workers that was
    asked for last, where the cloud may not list it yet.
    """
    machines = [machine for machine in observed.machines if machine.cluster == spec.cluster]
    begun = (seen.incarnation for seen in observed.lives if seen.cluster == spec.cluster)
    life = next(begun, "") or _latest_life(machines) or incarnation
    actions: list[Action] = [*prepare(life)]
    kept, endings = _sort_out(spec, machines, life, known_bad)
    desired = _desired(spec, observed, known)
    actions += _marks(spec, kept, observed, owner)
    actions += _set_workers(spec, kept, desired)
    actions += endings
    actions += _extensions(spec, kept, now)
    hidden = tuple(machine for machine in machines if machine.state is State.UNKNOWN)
    present_nodes = {machine.name.node for machine in (*kept, *hidden)}
    has_spot, subnets = spec.provider.has_spot, spec.provider.subnets
    for node in spec.nodes():
        if node not in present_nodes:
            name = NodeName(node, _next_generation(machines, node, life))
            choices = launch_choices(spec.profile(node), has_spot, subnets)
            borne = desired if node == HEAD else None
            actions.append(LaunchNode(name, spec.profile_name(node), choices, borne))
    return ClusterPlan(tuple(actions), tuple(kept), life, hidden, desired)


def _latest_life(machines: Iterable[MachineSeen]) -> str:
    """Return the incarnation of live machines, where nothing else bears it: the head's, if any."""
    live = [machine for machine in machines if machine.state in LIVE]
    heads = [machine for machine in live if machine.name.node == HEAD]
    return max((machine.incarnation for machine in heads or live), default="")


def _sort_out(
    spec: ClusterSpec, machines: Sequence[MachineSeen], life: str, known_bad: frozenset[str]
) -> tuple[list[MachineSeen], list[Terminate]]:
    """Tell the machines that stay, in the order of the nodes, from those that must go."""
    wanted = spec.nodes()
    best: dict[str, MachineSeen] = {}
    going: dict[Reason, list[MachineSeen]] = {}
    for machine in sorted(machines, key=_merit, reverse=True):
        node = machine.name.node
        if machine.state not in (*LIVE, State.STOPPED):
            continue
        if machine.id in known_bad:
            going.setdefault(Reason.UNUSABLE, []).append(machine)
        elif machine.state is State.STOPPED:
            going.setdefault(Reason.SHUT_DOWN, []).append(machine)
        elif machine.incarnation != life:
            going.setdefault(Reason.EARLIER_LIFE, []).append(machine)
        elif node not in wanted:
            going.setdefault(Reason.UNWANTED, []).append(machine)
        elif node in best:
            going.setdefault(Reason.DUPLICATE, []).append(machine)
        else:
            best[node] = machine
    kept = [best[node] for node in wanted if node in best]
    return kept, [Terminate(tuple(ending), why) for why, ending in going.items()]


def _marks(
    spec: ClusterSpec, kept: Sequence[MachineSeen], observed: Observed, owner: Owner
) -> list[Mark]:
    """Return the writing of the owner where it is due."""
    if not owner.key or not spec.provider.is_shared:
        return []
    machines = tuple(machine for machine in kept if not machine.owner.key)
    resources = tuple(
        life
        for life in observed.lives
        if life.cluster == spec.cluster and life.owner.key != owner.key
    )
    # Not for the resources alone: not every cloud can tag them.
    return [Mark(machines, resources, owner)] if machines else []


def _desired(spec: ClusterSpec, observed: Observed, known: Desired | None) -> Desired:
    """Return what was asked for last where it is the same; else the next revision."""
    before = max(filter(None, (observed.desired(spec.cluster), known)), default=None)
    if before is None or before.workers != spec.worker_count:
        return Desired(1 + (before.revision if before else 0), spec.worker_count)
    return before


def _set_workers(
    spec: ClusterSpec, kept: Sequence[MachineSeen], desired: Desired
) -> list[SetWorkers]:
    """Return the writing of the number of workers where it is due."""
    heads = [machine for machine in kept if machine.name.node == HEAD]
    is_due = spec.provider.makes_machines
    return [SetWorkers(head, desired) for head in heads if is_due and head.desired != desired]


def _merit(machine: MachineSeen) -> tuple[bool, int, str]:
    """Rank machines of one node: the one that runs, then the latest."""
    return machine.state is State.RUNNING, machine.name.generation, machine.id


def _extensions(spec: ClusterSpec, kept: Sequence[MachineSeen], now: datetime) -> list[Extend]:
    """Return the lease's extension where it is due."""
    if not spec.provider.makes_machines:
        return []
    until = now.replace(microsecond=0) + timedelta(seconds=spec.limits.lease)
    slack = timedelta(seconds=LEASE_SLACK * spec.limits.lease)
    due = tuple(m for m in kept if m.lease_until is None or abs(until - m.lease_until) > slack)
    return [Extend(due, until)] if due else []


def _next_generation(machines: Iterable[MachineSeen], node: str, life: str) -> int:
    """Return the first generation of a node that no machine of this life has had."""
    had = (m.name.generation for m in machines if m.name.node == node and m.incarnation == life)
    return max(had, default=0) + 1
