"""`up` and `down` on a cloud in memory, with everything that clouds do to them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from simulated import SetUp, SimulatedTime, make_cluster, make_spec, stub_set_up
from simulated.memory import MemoryProvider

from hpccomponent.errors import CloudError, LeftoverError, UsageError
from hpcdeploy.ownership.journal import open_journal
from hpcdeploy.provider import Launch, Observed, State, Tags
from hpcdeploy.reconcile.cluster import Cluster
from hpcdeploy.reconcile.converge import bring_up, look_ahead, replace_lost, take_down
from hpcdeploy.reconcile.plan import LaunchNode, Terminate
from hpcdeploy.spec.cluster import Limits
from hpcdeploy.spec.names import Desired, NodeName, read_desired

CHANGES = {
    "create_group", "create_key_pair", "allow", "tag", "launch", "terminate",
    "delete_group", "delete_key_pair",
}  # fmt: skip


@pytest.fixture
def set_up(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> SetUp:
    return stub_set_up(monkeypatch, tmp_path)


class Simulation:
    """A cloud, its time, the calls that it got and the lines that the user read."""

    def __init__(self) -> None:
        self.time = SimulatedTime()
        self.cloud = MemoryProvider(self.time.now, boot_s=30, end_s=20, unseen_s=3)
        self.cloud.hook = self.note
        self.calls: Counter[str] = Counter()
        self.lines: list[str] = []

    def note(self, moment: str, call: str) -> None:
        self.calls[call] += moment == "before"

    def up(self, count: int = 3, least: int | None = None, market: str = "on_demand") -> None:
        spec = make_spec(count, count if least is None else least, market)
        self.calls.clear()
        bring_up(make_cluster(spec, self.cloud), self.lines.append, polling=self.time.polling())

    def down(self) -> None:
        cluster = make_cluster(make_spec(), self.cloud)
        take_down(cluster, self.lines.append, polling=self.time.polling())

    def alive(self) -> list[str]:
        machines = self.cloud.observe(None).machines
        return sorted(m.name.node for m in machines if m.state in (State.PENDING, State.RUNNING))

    def left(self) -> Observed:
        seen = self.cloud.observe(None)
        alive = tuple(m for m in seen.machines if m.state is not State.GONE)
        return Observed(alive, seen.resources)


@pytest.fixture
def simulation(set_up: SetUp) -> Simulation:
    return Simulation()


def test_up_makes_what_the_file_says_and_down_takes_it_away(
    simulation: Simulation, set_up: SetUp
) -> None:
    simulation.up(3)
    assert simulation.alive() == ["head", "worker-1", "worker-2", "worker-3"]
    assert set_up.calls == [("head", "worker-1", "worker-2", "worker-3")]
    simulation.down()
    assert simulation.left() == Observed()


def test_up_refuses_what_may_cost_too_much(simulation: Simulation) -> None:
    spec = make_spec(3)
    frugal = spec.model_copy(update={"limits": Limits(max_hourly_cost=0.1)})
    with pytest.raises(UsageError, match="max_hourly_cost"):
        bring_up(make_cluster(frugal, simulation.cloud), simulation.lines.append)
    assert not simulation.calls


def test_up_again_makes_no_call_that_changes_anything(simulation: Simulation) -> None:
    simulation.up(3)
    simulation.up(3)
    assert not CHANGES & simulation.calls.keys()


def test_up_again_after_a_while_only_extends_the_lease(simulation: Simulation) -> None:
    simulation.up(3)
    simulation.time.advance(1800)
    simulation.up(3)
    assert CHANGES & simulation.calls.keys() == {"tag"}


def test_up_follows_the_file(simulation: Simulation) -> None:
    simulation.up(3)
    simulation.up(1)
    assert simulation.alive() == ["head", "worker-1"]
    simulation.time.advance(60)
    simulation.up(2)
    assert simulation.alive() == ["head", "worker-1", "worker-2"]


def test_up_again_after_down_is_a_new_life(simulation: Simulation) -> None:
    simulation.up(1)
    simulation.down()
    simulation.up(1)
    machines = simulation.cloud.observe(None).machines
    assert len({m.incarnation for m in machines}) == 2
    assert simulation.alive() == ["head", "worker-1"]


def test_down_of_nothing_is_done_at_once(simulation: Simulation) -> None:
    simulation.down()
    assert set(simulation.calls) == {"observe"}


def test_another_type_is_taken_where_the_first_is_not_to_be_had(simulation: Simulation) -> None:
    simulation.cloud.unavailable.add(("c6i.xlarge", "on_demand"))
    simulation.up(2)
    kinds = Counter(m.instance_type for m in simulation.cloud.observe(None).machines)
    assert kinds == {"m6i.large": 1, "c6a.xlarge": 2}


def test_machines_on_demand_where_no_spot_machine_is_to_be_had(simulation: Simulation) -> None:
    simulation.cloud.unavailable |= {("c6i.xlarge", "spot"), ("c6a.xlarge", "spot")}
    simulation.up(2, market="spot_with_fallback")
    markets = Counter(m.market for m in simulation.cloud.observe(None).machines)
    assert markets == {"on_demand": 3}


def test_capacity_that_comes_back_is_waited_for(simulation: Simulation) -> None:
    none = {("c6i.xlarge", "on_demand"), ("c6a.xlarge", "on_demand")}
    simulation.cloud.unavailable |= none

    def note(moment: str, call: str) -> None:
        if simulation.time.passed >= 5:
            simulation.cloud.unavailable.clear()

    simulation.cloud.hook = note
    simulation.up(2)
    assert simulation.alive() == ["head", "worker-1", "worker-2"]
    assert any("trying again in 5 s" in line for line in simulation.lines)


def test_without_enough_machines_up_fails_and_leaves_nothing(simulation: Simulation) -> None:
    simulation.cloud.unavailable |= {("c6i.xlarge", "on_demand"), ("c6a.xlarge", "on_demand")}
    with pytest.raises(
        CloudError, match=r"worker-1 \(and 1 more\) cannot be had: worker-1: no c6a"
    ):
        simulation.up(2)
    assert simulation.left() == Observed()


def test_a_failed_growth_leaves_what_was_there(simulation: Simulation, set_up: SetUp) -> None:
    simulation.up(1)
    set_up.broken_nodes = {"worker-2"}
    with pytest.raises(CloudError, match="worker-2 cannot be had: pip is missing"):
        simulation.up(2)
    simulation.time.advance(60)
    assert simulation.alive() == ["head", "worker-1"]


def test_kept_machines_stay(simulation: Simulation, set_up: SetUp) -> None:
    set_up.broken_nodes = {"worker-1"}
    cluster = make_cluster(make_spec(1, 1), simulation.cloud)
    with pytest.raises(CloudError, match="worker-1 cannot be had"):
        bring_up(cluster, simulation.lines.append, keep=True, polling=simulation.time.polling())
    assert "head" in simulation.alive()
    assert "hpcapp down cluster.yaml ends it" in simulation.lines[-1]


def test_what_up_does_is_what_was_shown_before(simulation: Simulation, set_up: SetUp) -> None:
    """A machine that was left and is known to be of no use is replaced, so it is asked about."""
    set_up.broken_nodes = {"worker-1"}
    cluster = make_cluster(make_spec(1, 1), simulation.cloud)
    with pytest.raises(CloudError, match="worker-1 cannot be had"):
        bring_up(cluster, simulation.lines.append, keep=True, polling=simulation.time.polling())
    simulation.time.advance(60)
    assert simulation.alive() == ["head", "worker-1"]
    set_up.broken_nodes = set()
    ahead = look_ahead(cluster)
    asked = [str(action) for action in ahead.actions if isinstance(action, Terminate | LaunchNode)]
    assert [line.split(" (")[0] for line in asked] == [
        "terminate worker-1",
        "launch worker-1 as c6i.xlarge or c6a.xlarge",
    ]
    bring_up(cluster, simulation.lines.append, polling=simulation.time.polling(), agreed=ahead)
    assert simulation.alive() == ["head", "worker-1"]
    assert not any(isinstance(a, Terminate | LaunchNode) for a in look_ahead(cluster).actions)


def test_a_machine_that_cannot_be_set_up_is_replaced(simulation: Simulation, set_up: SetUp) -> None:
    set_up.broken_once = {"worker-2"}
    simulation.up(3)
    assert simulation.alive() == ["head", "worker-1", "worker-2", "worker-3"]
    assert set_up.calls == [("head", "worker-1", "worker-2", "worker-3")] * 2
    assert any("worker-2: pip is missing; replacing it" in line for line in simulation.lines)


def test_a_smaller_cluster_will_do_where_min_allows_it(
    simulation: Simulation, set_up: SetUp
) -> None:
    set_up.broken_nodes = {"worker-2"}
    simulation.up(3, least=2)
    simulation.time.advance(60)
    assert simulation.alive() == ["head", "worker-1", "worker-3"]
    assert set_up.calls[-1] == ("head", "worker-1", "worker-3")
    assert simulation.lines[-1] == "going without worker-2: pip is missing"


def test_a_machine_that_never_boots_is_replaced_then_done_without(
    simulation: Simulation, set_up: SetUp
) -> None:
    simulation.cloud.never_boot = {"worker-1"}
    simulation.up(2, least=1)
    simulation.time.advance(60)
    assert simulation.alive() == ["head", "worker-2"]
    said = "\n".join(simulation.lines)
    assert "not running after 300 s" in said
    assert re.search(r"worker-1: its console ends so:\n\s*worker-1: booting", said), said


def test_preemptions_do_not_eat_the_budget(simulation: Simulation, set_up: SetUp) -> None:
    def interrupt(moment: str, call: str) -> None:
        simulation.calls[call] += moment == "before"
        if (moment, call) == ("before", "observe") and simulation.calls["launch"] in range(3, 9):
            simulation.cloud.interrupt("worker-1")

    simulation.cloud.hook = interrupt
    simulation.up(2, market="spot")
    assert simulation.alive() == ["head", "worker-1", "worker-2"]
    assert simulation.calls["launch"] == 9


def test_down_also_ends_machines_of_an_earlier_life_and_those_the_cloud_does_not_list_yet(
    simulation: Simulation,
) -> None:
    simulation.up(1)
    cluster = make_cluster(make_spec(1), simulation.cloud)
    owner = cluster.access.owner()
    simulation.cloud.launch(Launch("bunny", "earlier", NodeName("worker-7"), owner=owner))
    take_down(cluster, simulation.lines.append, polling=simulation.time.polling())
    assert simulation.left() == Observed()


def test_down_names_what_it_cannot_take_away(simulation: Simulation) -> None:
    simulation.up(1)

    def refuse(moment: str, call: str) -> None:
        if call == "delete_group":
            raise CloudError("not authorized to delete the group")

    simulation.cloud.hook = refuse
    said = r"security group hpcapp-bunny \(not authorized to delete the group\); it may cost"
    with pytest.raises(LeftoverError, match=said):
        simulation.down()


def test_lost_workers_are_replaced_and_nothing_else_is_changed(
    simulation: Simulation, set_up: SetUp
) -> None:
    simulation.up(2, market="spot")
    cluster = make_cluster(make_spec(2, market="spot"), simulation.cloud)
    replace_lost(cluster, simulation.lines.append, polling=simulation.time.polling())
    assert len(set_up.calls) == 1
    simulation.cloud.interrupt("worker-2")
    simulation.time.advance(3600)
    simulation.calls.clear()
    replace_lost(cluster, simulation.lines.append, polling=simulation.time.polling())
    assert simulation.alive() == ["head", "worker-1", "worker-2"]
    assert CHANGES & simulation.calls.keys() == {"launch"}
    assert set_up.calls[-1] == ("head", "worker-1", "worker-2")


def test_a_lost_head_is_not_replaced_during_a_job(simulation: Simulation) -> None:
    simulation.up(2)
    simulation.cloud.interrupt("head")
    cluster = make_cluster(make_spec(2), simulation.cloud)
    with pytest.raises(CloudError, match=r"the head of cluster bunny does not run; run hpcapp up"):
        replace_lost(cluster, simulation.lines.append, polling=simulation.time.polling())


@pytest.mark.parametrize(
    ("run", "count"),
    [(bring_up, 3), (bring_up, 5), (replace_lost, 3)],
    ids=["up", "scale", "watch"],
)
def test_nothing_is_launched_for_a_head_that_runs_and_lets_nobody_in(
    simulation: Simulation, run: Callable[..., object], count: int
) -> None:
    simulation.up(3)
    simulation.cloud.interrupt("worker-1")
    simulation.time.advance(60)
    cluster = make_cluster(make_spec(count), simulation.cloud)
    vars(cluster.access)["silent"] = {"head"}
    simulation.calls.clear()
    said = (
        r"^head cannot be had: unreachable: no answer; it stays, for it may be at work; "
        r"mend it \(hpcapp ssh cluster.yaml head\); where it lets nobody in, end i-\w+ in the "
        r"cloud's console and run hpcapp up cluster.yaml, or begin anew: hpcapp down [^\n]*$"
    )
    with pytest.raises(CloudError, match=said):
        run(cluster, simulation.lines.append, polling=simulation.time.polling())
    assert not CHANGES & simulation.calls.keys()
    assert simulation.alive() == ["head", "worker-2", "worker-3"]


def test_workers_go_though_the_head_lets_nobody_in(simulation: Simulation, set_up: SetUp) -> None:
    simulation.up(3)
    simulation.time.advance(60)
    cluster = make_cluster(make_spec(1), simulation.cloud)
    vars(cluster.access)["silent"] = {"head"}
    bring_up(cluster, simulation.lines.append, polling=simulation.time.polling())
    assert simulation.alive() == ["head", "worker-1"]


@pytest.mark.parametrize("count", [0, 1, 5])
def test_who_watches_goes_by_the_last_number_of_workers(simulation: Simulation, count: int) -> None:
    """A `submit` has read the file when it said 3; meanwhile somebody else has scaled."""
    simulation.up(3)
    watched = make_cluster(make_spec(3), simulation.cloud)
    simulation.up(count)
    nodes = simulation.alive()
    for _ in range(2):
        simulation.time.advance(60)
        watched = replace_lost(watched, simulation.lines.append, polling=simulation.time.polling())
        assert simulation.alive() == nodes
    word = "grew" if count > 3 else "shrank"
    said = f"cluster bunny {word} from 3 to {count} workers, by the last hpcapp scale or up"
    assert simulation.lines.count(said) == 1
    assert watched.spec.worker_count == count


def test_who_watches_holds_the_limits_of_the_own_file(simulation: Simulation) -> None:
    """Somebody who shares the key has scaled, by another file."""
    simulation.up(8)
    frugal = make_spec(1).model_copy(update={"limits": Limits(max_hourly_cost=0.5)})
    simulation.cloud.interrupt("worker-2")
    simulation.calls.clear()
    with pytest.raises(UsageError, match="max_hourly_cost"):
        replace_lost(make_cluster(frugal, simulation.cloud), simulation.lines.append)
    assert not CHANGES & simulation.calls.keys()


def test_a_tag_that_asks_for_more_than_a_file_may_is_none_of_ours() -> None:
    assert read_desired(str(Desired(7, 1000))) == Desired(7, 1000)
    for text in ("1001, revision 7", "3", "-1, revision 7", "3, revision x", ""):
        assert read_desired(text) is None


def test_who_watches_keeps_nobody_from_a_change_while_nothing_is_lost(
    simulation: Simulation,
) -> None:
    simulation.up(2)
    watched = make_cluster(make_spec(3), simulation.cloud)
    with open_journal("bunny"):
        watched = replace_lost(watched, simulation.lines.append, polling=simulation.time.polling())
        assert watched.spec.worker_count == 2
        simulation.cloud.interrupt("worker-2")
        with pytest.raises(CloudError, match="is being changed by another hpcapp"):
            replace_lost(watched, simulation.lines.append, polling=simulation.time.polling())


def test_who_watches_sets_up_what_an_earlier_one_has_left_half_done(
    simulation: Simulation, set_up: SetUp
) -> None:
    simulation.up(2)
    cluster = make_cluster(make_spec(2), simulation.cloud)
    simulation.cloud.interrupt("worker-2")
    simulation.time.advance(60)

    def leave() -> None:
        set_up.during = lambda: None
        raise KeyboardInterrupt

    set_up.during = leave
    with pytest.raises(KeyboardInterrupt):
        replace_lost(cluster, simulation.lines.append, polling=simulation.time.polling())
    assert simulation.alive() == ["head", "worker-1", "worker-2"]
    calls = len(set_up.calls)
    for _ in range(2):
        replace_lost(cluster, simulation.lines.append, polling=simulation.time.polling())
        assert len(set_up.calls) == calls + 1


def test_what_is_launched_for_a_lost_worker_goes_again_where_it_is_not_wanted_any_more(
    simulation: Simulation,
) -> None:
    """Somebody who shares the key scales from elsewhere, while a lost worker is replaced."""
    simulation.up(2)
    watched = make_cluster(make_spec(2), simulation.cloud)
    simulation.cloud.interrupt("worker-2")
    simulation.time.advance(60)

    def scale(moment: str, call: str) -> None:
        if (moment, call) == ("before", "launch"):
            [head] = [m for m in simulation.cloud.observe(None).machines if m.name.node == "head"]
            assert head.desired == Desired(1, 2)
            simulation.cloud.tag([head], Tags(desired=Desired(2, 1)))

    simulation.cloud.hook = scale
    replace_lost(watched, simulation.lines.append, polling=simulation.time.polling())
    assert simulation.alive() == ["head", "worker-1"]


def test_an_up_that_another_command_outdates_does_what_the_later_one_wants(
    simulation: Simulation, set_up: SetUp
) -> None:
    def scale(count: int) -> None:
        machines = simulation.cloud.observe(None).machines
        head = next(m for m in machines if m.name.node == "head" and m.state is State.RUNNING)
        simulation.cloud.tag([head], Tags(desired=Desired(2, count)))
        set_up.during = lambda: None

    set_up.during = lambda: scale(1)
    simulation.up(3)
    assert simulation.alive() == ["head", "worker-1"]
    assert set_up.calls[-1] == ("head", "worker-1")
    set_up.during = lambda: scale(5)  # what is launched beyond is the other command's
    simulation.down()
    simulation.up(2)
    assert simulation.alive() == ["head", "worker-1", "worker-2"]


def test_a_worker_that_was_given_up_does_not_count_once_nobody_wants_it(
    simulation: Simulation, set_up: SetUp
) -> None:
    def scale_once_it_is_given_up() -> None:
        if "worker-3" not in set_up.calls[-1]:
            machines = simulation.cloud.observe(None).machines
            [head] = [m for m in machines if m.name.node == "head"]
            simulation.cloud.tag([head], Tags(desired=Desired(2, 1)))

    set_up.broken_nodes = {"worker-3"}
    set_up.during = scale_once_it_is_given_up
    simulation.up(3, least=1)
    simulation.time.advance(60)
    assert simulation.alive() == ["head", "worker-1"]
    assert not any(line.startswith("going without") for line in simulation.lines)


def test_a_failed_growth_is_not_made_good_by_who_watches(
    simulation: Simulation, set_up: SetUp
) -> None:
    simulation.up(1)
    watched: Cluster = make_cluster(make_spec(1), simulation.cloud)
    set_up.broken_nodes = {"worker-2"}
    with pytest.raises(CloudError, match="worker-2 cannot be had"):
        simulation.up(2)
    set_up.broken_nodes = set()
    simulation.time.advance(60)
    replace_lost(watched, simulation.lines.append, polling=simulation.time.polling())
    assert simulation.alive() == ["head", "worker-1"]


def test_a_head_that_is_replaced_bears_the_number_of_workers(simulation: Simulation) -> None:
    simulation.up(3)
    simulation.up(1)
    simulation.cloud.interrupt("head")
    simulation.time.advance(60)
    simulation.up(2)
    watched = make_cluster(make_spec(3), simulation.cloud)
    replace_lost(watched, simulation.lines.append, polling=simulation.time.polling())
    assert simulation.alive() == ["head", "worker-1", "worker-2"]
