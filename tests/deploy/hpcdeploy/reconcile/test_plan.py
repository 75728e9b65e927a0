"""The plan is pure; carried out on a model of the cloud it converges, and then is empty."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import TypeVar

import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated import START, key_pairs_of, make_spec

from hpccomponent.config.reader import parse_config
from hpcdeploy.provider import MachineSeen, Observed, Prerequisites, Resource, State, Step
from hpcdeploy.providers.ec2.access import plan_access
from hpcdeploy.providers.ec2.observe import GroupSeen, KeyPairSeen
from hpcdeploy.reconcile.plan import (
    Action,
    ClusterPlan,
    Extend,
    LaunchNode,
    SetWorkers,
    Terminate,
    launch_choices,
    make_plan,
)
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.names import NOBODY, Desired, NodeName, Owner

Made = TypeVar("Made", bound=Resource)
NETWORKS = frozenset({"192.0.2.0/24"})
NODES = ["head", "worker-1", "worker-2", "worker-3", "worker-9"]


@dataclass
class Model:
    """A cloud's lists, as its keeper of groups and key pairs changes them."""

    observed: Observed

    def owner(self) -> Owner:
        return NOBODY

    def public_key(self) -> str:
        return "key"

    def create_group(self, cluster: str, incarnation: str, owner: Owner) -> GroupSeen:
        return self._add(GroupSeen(cluster, "n", incarnation, "sg"))

    def allow(
        self, group: GroupSeen, ssh_from: frozenset[str], internal_ports: frozenset[int]
    ) -> None:
        others = [seen for seen in self.observed.resources if seen != group]
        self.observed = replace(self.observed, resources=tuple(others))
        self._add(replace(group, ssh_from=ssh_from, internal_ports=internal_ports))

    def create_key_pair(self, cluster: str, incarnation: str, public_key: str) -> KeyPairSeen:
        return self._add(KeyPairSeen(cluster, "n", incarnation))

    def _add(self, made: Made) -> Made:
        self.observed = replace(self.observed, resources=(*self.observed.resources, made))
        return made


def carry_out(observed: Observed, action: Action) -> Observed:
    """What the cloud would list after an action that is no step of the preparation."""
    cluster = "bunny"
    match action:
        case LaunchNode(name, _, choices, desired):
            group = next(g for g in observed.lives if g.cluster == cluster)
            machine = MachineSeen(
                f"new-{name.node}-{name.generation}",
                cluster,
                name,
                group.incarnation,
                State.RUNNING,
                instance_type=choices[0][0],
                lease_until=START + timedelta(hours=2),
                desired=desired,
            )
            return replace(observed, machines=(*observed.machines, machine))
        case Terminate(machines) | Extend(machines):
            ids = {machine.id for machine in machines}
            until = action.lease_until if isinstance(action, Extend) else None
            return replace(
                observed,
                machines=tuple(
                    seen
                    if seen.id not in ids
                    else replace(seen, lease_until=until)
                    if until
                    else replace(seen, state=State.GONE)
                    for seen in observed.machines
                ),
            )
        case SetWorkers(head, desired):
            return replace(
                observed,
                machines=tuple(
                    replace(seen, desired=desired) if seen.id == head.id else seen
                    for seen in observed.machines
                ),
            )
    raise AssertionError(action)


def plan_for(spec: ClusterSpec, observed: Observed) -> ClusterPlan:
    return make_plan(spec, observed, START, "life", preparing(Model(observed)))


def preparing(model: Model) -> Callable[[str], Sequence[Step]]:
    def prepare(life: str) -> Sequence[Step]:
        wanted = Prerequisites("bunny", life, NETWORKS, frozenset({7070}))
        return plan_access(model, wanted, model.observed)

    return prepare


def converged(spec: ClusterSpec, observed: Observed = Observed()) -> Observed:  # noqa: B008
    model = Model(observed)
    for action in make_plan(spec, observed, START, "life", preparing(model)).actions:
        if isinstance(action, Step):
            action.carry_out(model)
        else:
            model.observed = carry_out(model.observed, action)
    return model.observed


machines = st.builds(
    MachineSeen,
    id=st.uuids().map(str),
    cluster=st.sampled_from(["bunny", "bunny", "bunny", "foreign"]),
    name=st.builds(NodeName, st.sampled_from(NODES), st.integers(1, 3)),
    incarnation=st.sampled_from(["life", "life", "earlier"]),
    state=st.sampled_from(State),
    lease_until=st.none() | st.just(START) | st.just(START + timedelta(minutes=115)),
    desired=st.none() | st.builds(Desired, st.integers(1, 3), st.integers(0, 4)),
)
groups = st.builds(
    GroupSeen,
    cluster=st.sampled_from(["bunny", "foreign"]),
    id=st.just("sg-1"),
    name=st.just("n"),
    incarnation=st.sampled_from(["life", "earlier"]),
    ssh_from=st.sampled_from([NETWORKS, frozenset({"0.0.0.0/0"})]),
    internal_ports=st.sampled_from([frozenset({7070}), frozenset({22})]),
)
observations = st.builds(
    Observed,
    st.lists(machines, max_size=8).map(tuple),
    st.tuples(
        st.lists(groups, max_size=2, unique_by=lambda group: group.cluster).map(tuple),
        st.sampled_from([(), (KeyPairSeen("bunny", "n", "life"),)]),
    ).map(lambda resources: resources[0] + resources[1]),
)


@given(observations, st.integers(0, 4))
def test_a_plan_converges_and_a_second_one_is_empty(observed: Observed, count: int) -> None:
    spec = make_spec(count)
    after = converged(spec, observed)
    assert plan_for(spec, after).actions == ()
    alive = [
        machine.name.node
        for machine in after.machines
        if machine.cluster == "bunny" and machine.state in (State.PENDING, State.RUNNING)
    ]
    hidden = {m.name.node for m in after.machines if m.state is State.UNKNOWN}
    assert max(Counter(alive).values(), default=0) <= 1
    assert set(alive) <= set(spec.nodes()) <= set(alive) | hidden


@given(observations, st.integers(0, 4))
def test_a_plan_never_touches_another_cluster_and_never_ends_a_machine_it_keeps(
    observed: Observed, count: int
) -> None:
    plan = plan_for(make_spec(count), observed)
    kept = {machine.id for machine in plan.kept}
    for action in plan.actions:
        if isinstance(action, Terminate | Extend):
            assert {machine.cluster for machine in action.machines} == {"bunny"}
        if isinstance(action, Terminate):
            assert kept.isdisjoint(machine.id for machine in action.machines)
            assert all(machine.state is not State.UNKNOWN for machine in action.machines)
        if isinstance(action, LaunchNode):
            assert action.name.node not in {machine.name.node for machine in plan.hidden}


@given(observations)
def test_no_generation_is_used_twice(observed: Observed) -> None:
    plan = plan_for(make_spec(4), observed)
    used = {(m.name, m.incarnation) for m in observed.machines if m.cluster == "bunny"}
    for action in plan.actions:
        if isinstance(action, LaunchNode):
            assert (action.name, plan.incarnation) not in used


def test_from_nothing_the_group_comes_first_and_the_machines_last() -> None:
    plan = plan_for(make_spec(1), Observed())
    assert [str(action) for action in plan.actions] == [
        "create the security group",
        "allow SSH from 192.0.2.0/24, port 7070 inside",
        "create the key pair",
        "launch head as m6i.large (on_demand)",
        "launch worker-1 as c6i.xlarge or c6a.xlarge (on_demand)",
    ]


def test_a_bad_machine_is_replaced_by_the_next_generation() -> None:
    spec = make_spec(1)
    observed = converged(spec)
    plan = make_plan(
        spec, observed, START, "", preparing(Model(observed)), frozenset({"new-worker-1-1"})
    )
    assert [str(action) for action in plan.actions] == [
        "terminate worker-1 (new-worker-1-1): it could not be set up",
        "launch worker-1 as c6i.xlarge or c6a.xlarge (on_demand), generation 2",
    ]


def test_a_smaller_file_ends_the_last_workers() -> None:
    plan = plan_for(make_spec(1), converged(make_spec(3)))
    fewer, ending = plan.actions
    assert str(fewer) == "set the number of workers to 1"  # before any of them goes
    assert isinstance(ending, Terminate)
    assert {machine.name.node for machine in ending.machines} == {"worker-2", "worker-3"}


@pytest.mark.parametrize(("minutes", "is_extended"), [(0, False), (11, False), (13, True)])
def test_the_lease_is_extended_once_a_tenth_has_passed(minutes: int, is_extended: bool) -> None:
    spec = make_spec(1)
    observed = converged(spec)
    now = START + timedelta(minutes=minutes)
    actions = make_plan(spec, observed, now, "", preparing(Model(observed))).actions
    assert [type(action) for action in actions] == ([Extend] if is_extended else [])


def test_a_group_that_vanished_is_made_again_for_the_life_of_its_machines() -> None:
    spec = make_spec(1)
    observed = converged(spec)
    observed = replace(observed, resources=tuple(key_pairs_of(observed)))
    plan = make_plan(spec, observed, START, "new life", preparing(Model(observed)))
    group, rules = plan.actions
    assert isinstance(group, Step)
    assert group.begins == "life"
    assert str(rules) == "allow SSH from 192.0.2.0/24, port 7070 inside"


@pytest.mark.parametrize(
    ("market", "choices"),
    [
        ("on_demand", ["c6i.xlarge on_demand", "c6a.xlarge on_demand"]),
        ("spot", ["c6i.xlarge spot", "c6a.xlarge spot"]),
        (
            "spot_with_fallback",
            ["c6i.xlarge spot", "c6a.xlarge spot", "c6i.xlarge on_demand", "c6a.xlarge on_demand"],
        ),
    ],
)
def test_spot_comes_before_on_demand(market: str, choices: list[str]) -> None:
    profile = make_spec(market=market).profile("worker-1")
    assert [f"{c.instance_type} {c.market}" for c in launch_choices(profile)] == choices
    without_spot = launch_choices(profile, has_spot=False)
    assert set(without_spot) <= set(launch_choices(profile))
    assert profile is not None
    assert ("spot" in {choice.market for choice in without_spot}) == (profile.market == "spot")


def test_all_places_come_before_the_next_type() -> None:
    profile = make_spec(market="spot_with_fallback").profile("worker-1")
    assert profile is not None
    zoned = profile.model_copy(update={"zone": ("a", "b")})
    assert list(map(str, launch_choices(zoned)))[:5] == [
        "c6i.xlarge (spot, a)", "c6i.xlarge (spot, b)", "c6a.xlarge (spot, a)",
        "c6a.xlarge (spot, b)", "c6i.xlarge (on_demand, a)",
    ]  # fmt: skip
    launch = LaunchNode(NodeName("worker-1"), "fast", launch_choices(zoned))
    told = "launch worker-1 as c6i.xlarge or c6a.xlarge (spot, else on_demand, in a or b)"
    assert str(launch) == told
    subnets = ("subnet-1", "subnet-2")
    assert {choice.place for choice in launch_choices(profile, subnets=subnets)} == set(subnets)
    one = profile.model_copy(update={"zone": "a"})
    assert launch_choices(one) == launch_choices(profile, subnets=("subnet-1",))


def test_where_machines_are_there_no_group_no_key_pair_and_no_lease_is_planned() -> None:
    text = "version: 1\ncluster: c\nprovider: {type: ssh, hosts: [{address: a}, {address: b}]}"
    plan = make_plan(parse_config(text, "c.yaml", ClusterSpec), Observed(), START, "life")
    assert [str(action) for action in plan.actions] == ["launch head", "launch worker-1"]
