"""What has outlived its use is found by the cloud's lists alone."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path

import pytest
from simulated import START, SimulatedTime, key_pairs_of, make_cluster, make_spec, stub_set_up
from simulated.memory import MemoryProvider

from hpccomponent.errors import LeftoverError
from hpcdeploy.provider import Launch, MachineSeen, Observed, State
from hpcdeploy.providers.ec2.observe import GroupSeen, KeyPairSeen
from hpcdeploy.reconcile.converge import bring_up
from hpcdeploy.reconcile.reap import overdue, reap
from hpcdeploy.spec.names import NodeName, draw_incarnation

HOUR = timedelta(hours=1)


def group(cluster: str, age: timedelta) -> GroupSeen:
    return GroupSeen(cluster, f"hpcapp-{cluster}", draw_incarnation(START - age), "sg")


def machine(
    cluster: str,
    lease_left: timedelta | None,
    state: State = State.RUNNING,
    age: timedelta = 2 * HOUR,
) -> MachineSeen:
    until = None if lease_left is None else START + lease_left
    return MachineSeen(
        f"i-{cluster}",
        cluster,
        NodeName("head"),
        "life",
        state,
        launched=START - age,
        lease_until=until,
    )


def pair_of(group: GroupSeen) -> KeyPairSeen:
    return KeyPairSeen(group.cluster, f"{group.name}-{group.incarnation}", group.incarnation)


@pytest.mark.parametrize(
    ("lease_left", "state", "age", "goes"),
    [
        (HOUR, State.RUNNING, 2 * HOUR, False),
        (-timedelta(minutes=4), State.RUNNING, 2 * HOUR, False),  # clocks differ
        (-timedelta(minutes=6), State.RUNNING, 2 * HOUR, True),
        (-HOUR, State.PENDING, 2 * HOUR, True),
        (-HOUR, State.GONE, 2 * HOUR, False),
        (HOUR, State.STOPPED, 2 * HOUR, True),  # has shut itself down, its disk still costs
        (None, State.RUNNING, timedelta(minutes=50), False),  # its tags are being written
        (None, State.RUNNING, timedelta(days=2), False),  # its guard knows its lease
        (None, State.STOPPED, timedelta(minutes=50), False),
        (None, State.STOPPED, timedelta(minutes=70), True),
    ],
)
def test_a_machine_goes_by_its_lease_or_when_it_has_shut_down(
    lease_left: timedelta | None, state: State, age: timedelta, goes: bool
) -> None:
    seen = machine("bunny", lease_left, state, age)
    observed = Observed((seen,), (group("bunny", timedelta(minutes=1)),))
    assert overdue(observed, START).machines == ((seen,) if goes else ())


def test_a_machine_whose_group_is_not_listed_stays_while_its_lease_lasts() -> None:
    seen = machine("bunny", HOUR, age=timedelta(days=2))
    assert overdue(Observed((seen,)), START) == Observed()


def test_a_machine_that_runs_without_a_lease_stays_and_is_named(tmp_path: Path) -> None:
    time = SimulatedTime()
    cloud = MemoryProvider(time.now)
    seen = cloud.launch(Launch("bunny", "life", NodeName("head")))
    time.advance(2 * 24 * 3600)
    lines: list[str] = []
    reap(cloud, lines.append, time.polling())
    assert [m.state for m in cloud.observe(None).machines] == [State.RUNNING]
    assert lines == [
        f"head {seen.id} of cluster bunny runs and bears no lease: it stays, its owner's "
        "hpcapp down removes it"
    ]


@pytest.mark.parametrize(
    ("age", "lease_left", "goes"),
    [
        (timedelta(minutes=50), None, False),  # somebody is making the cluster
        (timedelta(minutes=70), None, True),
        (2 * HOUR, HOUR, False),  # a machine is in it
        (2 * HOUR, -HOUR, True),  # which goes, and the group with it
    ],
)
def test_a_group_and_its_key_pair_go_once_nobody_can_need_them(
    age: timedelta, lease_left: timedelta | None, goes: bool
) -> None:
    machines = () if lease_left is None else (machine("bunny", lease_left),)
    made = group("bunny", age)
    found = overdue(Observed(machines, (made, pair_of(made))), START)
    assert bool(found.lives) == goes
    assert bool(key_pairs_of(found)) == goes


@pytest.mark.parametrize(("age", "goes"), [(HOUR / 2, False), (2 * HOUR, True)])
def test_a_key_pair_without_its_group_is_an_orphan_once_it_is_old(
    age: timedelta, goes: bool
) -> None:
    pair, later = pair_of(group("bunny", age)), group("bunny", timedelta(minutes=1))
    for groups in ((), (later,)):
        orphans = overdue(Observed((), (*groups, pair, pair_of(later))), START)
        assert key_pairs_of(orphans) == ([pair] if goes else [])


def test_a_new_life_is_left_alone_though_machines_of_the_last_one_are_listed() -> None:
    gone = machine("bunny", -HOUR, State.GONE)
    young = group("bunny", timedelta(minutes=1))
    assert overdue(Observed((gone,), (young, pair_of(young))), START) == Observed()


@pytest.fixture
def time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SimulatedTime:
    stub_set_up(monkeypatch, tmp_path)
    return SimulatedTime()


def up(cloud: MemoryProvider, time: SimulatedTime, name: str) -> None:
    cluster = make_cluster(make_spec(1, cluster=name), cloud)
    bring_up(cluster, lambda line: None, polling=time.polling())


def test_expired_clusters_are_removed_and_others_stay(time: SimulatedTime) -> None:
    cloud = MemoryProvider(time.now, boot_s=30, end_s=20)
    up(cloud, time, "old")
    time.advance(1.5 * 3600)
    up(cloud, time, "young")
    time.advance(1.5 * 3600)
    lines: list[str] = []
    reap(cloud, lines.append, time.polling())
    left = cloud.observe(None)
    assert {m.cluster for m in left.machines if m.state is State.RUNNING} == {"young"}
    assert [g.cluster for g in left.lives] == [p.cluster for p in key_pairs_of(left)] == ["young"]
    assert any(line.startswith("terminating head (i-") for line in lines)


def test_what_cannot_be_removed_is_named(time: SimulatedTime) -> None:
    cloud = MemoryProvider(time.now, end_s=1e9)
    cloud.launch(Launch("bunny", "life", NodeName("head"), lease_until=START - HOUR))
    time.advance(7200)
    with pytest.raises(LeftoverError, match=r"still there: head i-\d+ \(ending\); it may cost"):
        reap(cloud, lambda line: None, time.polling())
