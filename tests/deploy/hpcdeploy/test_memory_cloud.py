"""The cloud in memory has the habits of real ones."""

from __future__ import annotations

import pytest
from simulated import START, SimulatedTime
from simulated.memory import MemoryProvider

from hpccomponent.errors import CapacityError, CloudError
from hpcdeploy.provider import Launch, Provider, State, Tags
from hpcdeploy.spec.names import NOBODY, NodeName

LAUNCH = Launch("bunny", "life", NodeName("head"), "small", "m6i.large", lease_until=START)


def states(cloud: MemoryProvider) -> list[State]:
    return [machine.state for machine in cloud.observe("bunny").machines]


def test_is_a_provider() -> None:
    cloud: Provider = MemoryProvider()
    assert cloud.makes_machines
    assert cloud.check() == []


def test_a_machine_is_pending_then_runs_then_ends_then_is_gone_then_forgotten() -> None:
    time = SimulatedTime()
    cloud = MemoryProvider(time.now, boot_s=30, end_s=20, listed_s=100)
    machine = cloud.launch(LAUNCH)
    assert machine.state is State.PENDING
    time.advance(30)
    assert states(cloud) == [State.RUNNING]
    cloud.terminate([machine])
    assert states(cloud) == [State.ENDING]
    time.advance(20)
    assert states(cloud) == [State.GONE]
    time.advance(101)
    assert states(cloud) == []


def test_the_same_request_gives_the_same_machine_even_when_it_is_gone() -> None:
    cloud = MemoryProvider()
    first = cloud.launch(LAUNCH)
    assert cloud.launch(LAUNCH).id == first.id
    cloud.terminate([first])
    again = cloud.launch(LAUNCH)
    assert (again.id, again.state) == (first.id, State.GONE)


def test_a_fresh_machine_is_unseen_and_yet_keeps_its_group() -> None:
    time = SimulatedTime()
    cloud = MemoryProvider(time.now, unseen_s=10)
    group = cloud.create_group("bunny", "life", NOBODY)
    machine = cloud.launch(LAUNCH)
    assert states(cloud) == []
    assert not cloud.delete_group(group)
    cloud.terminate([machine])
    assert cloud.delete_group(group)


def test_a_group_and_a_key_pair_are_made_once() -> None:
    cloud = MemoryProvider()
    assert cloud.create_group("bunny", "b", NOBODY) == cloud.create_group("bunny", "a", NOBODY)
    assert cloud.create_key_pair("bunny", "a", "k") == cloud.create_key_pair("bunny", "a", "other")
    assert len(cloud.observe(None).lives) == 1
    assert cloud.observe("other").lives == ()


def test_a_group_that_another_command_has_deleted_cannot_be_changed() -> None:
    provider = MemoryProvider()
    gone = provider.create_group("bunny", "aa11", NOBODY)
    assert provider.delete_group(gone)
    provider.create_group("bunny", "bb22", NOBODY)
    with pytest.raises(CloudError, match="is gone"):
        provider.allow(gone, frozenset({"192.0.2.0/24"}), frozenset())
    with pytest.raises(CloudError, match="is gone"):
        provider.tag((), Tags(NOBODY), (gone,))


def test_capacity_runs_out_for_a_type_and_market() -> None:
    cloud = MemoryProvider()
    cloud.unavailable.add(("m6i.large", "on_demand"))
    with pytest.raises(CapacityError, match=r"head: no m6i\.large \(on_demand\) to be had; try"):
        cloud.launch(LAUNCH)


def test_an_answer_is_lost_after_the_work_is_done() -> None:
    cloud = MemoryProvider()

    def lose(moment: str, call: str) -> None:
        if (moment, call) == ("after", "launch"):
            raise CloudError("connection lost")

    cloud.hook = lose
    with pytest.raises(CloudError):
        cloud.launch(LAUNCH)
    assert len(cloud.observe(None).machines) == 1


def test_an_interrupted_machine_tells_why() -> None:
    cloud = MemoryProvider()
    cloud.launch(LAUNCH)
    cloud.interrupt("head")
    assert cloud.observe(None).machines[0].reason == "Server.SpotInstanceTermination"
