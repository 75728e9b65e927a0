"""`up`, `down` and `reap` under thousands of faults and crashes, on a cloud in memory."""

from __future__ import annotations

import itertools
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from simulated import SetUp, SimulatedTime, make_cluster, make_spec
from simulated.memory import MemoryProvider

from hpccomponent.errors import CloudError
from hpcdeploy.provider import Launch, Observed, State
from hpcdeploy.reconcile.converge import bring_up, replace_lost, take_down
from hpcdeploy.reconcile.reap import reap
from hpcdeploy.spec.names import NOBODY, NodeName

KINDS = [
    (kind, market)
    for kind in ("m6i.large", "c6i.xlarge", "c6a.xlarge")
    for market in ("spot", "on_demand")
]
FAULTS = st.sampled_from(["none", "none", "error", "lost answer", "killed"])


class Killed(BaseException):
    """Ends a command like kill -9: nothing of ours may catch it."""


class World:
    """A cloud with one cluster of ours and one of somebody else, and what goes wrong in it."""

    def __init__(self, patch: pytest.MonkeyPatch, home: Path) -> None:
        patch.setenv("XDG_STATE_HOME", str(home))
        self.time = SimulatedTime()
        self.cloud = MemoryProvider(self.time.now, boot_s=30, end_s=20, unseen_s=4)
        self.set_up = SetUp(during=lambda: self.strike("before", "set_up"))
        patch.setattr("hpcdeploy.install.bootstrap.set_up", self.set_up)
        patch.setattr("hpcdeploy.install.user_data.user_data", lambda *about: "#!")
        self.foreign = self.cloud.launch(Launch("foreign", "life", NodeName("head")))
        self.cloud.create_group("foreign", "life", NOBODY)
        self.fault, self.countdown, self.is_dead = "none", 0, False
        self.cloud.hook = self.strike

    def strike(self, moment: str, call: str) -> None:
        """Let the armed fault come about at the call it was armed for."""
        if moment == "after" and call == "launch":
            self.check_no_duplicate()
        if self.is_dead:
            raise Killed
        wanted = "after" if self.fault == "lost answer" else "before"
        if self.fault == "none" or (moment != wanted and self.fault != "killed"):
            return
        self.countdown -= 1
        if self.countdown == 0:
            fault, self.fault = self.fault, "none"
            self.is_dead = fault == "killed"
            raise Killed if self.is_dead else CloudError(f"{call}: injected")

    def alive(self) -> list[Any]:
        """All machines, listed or not, that are ours and not ending."""
        seen = [self.cloud._seen(machine) for machine in self.cloud._machines.values()]
        states = (State.PENDING, State.RUNNING)
        return [m for m in seen if m.cluster == "bunny" and m.state in states]

    def check_no_duplicate(self) -> None:
        nodes = Counter(machine.name.node for machine in self.alive())
        assert max(nodes.values(), default=0) <= 1, nodes

    def run(self, verb: Any, *arguments: Any, fault: str = "none", at: int = 1) -> str:
        """Run a verb with a fault armed; return how it ended."""
        self.fault, self.countdown, self.is_dead = fault, at, False
        try:
            verb(*arguments, lambda line: None, polling=self.time.polling())
        except Killed:
            return "killed"
        except CloudError:
            return "failed"
        finally:
            self.fault, self.is_dead = "none", False
        return "done"

    def up(self, count: int, least: int, market: str, **fault: Any) -> str:
        cluster = make_cluster(make_spec(count, least, market), self.cloud)
        return self.run(bring_up, cluster, **fault)

    def down(self, **fault: Any) -> str:
        return self.run(take_down, make_cluster(make_spec(), self.cloud), **fault)

    def left(self) -> Observed:
        """All that is left of ours, listed or not."""
        seen = self.cloud.observe("bunny")
        unended = [self.cloud._seen(m) for m in self.cloud._machines.values()]
        ours = tuple(m for m in unended if m.cluster == "bunny" and m.state is not State.GONE)
        return Observed(ours, seen.resources)


class ClusterLife(RuleBasedStateMachine):
    """Commands, faults and time in any order."""

    @initialize()
    def begin(self) -> None:
        self.patch = pytest.MonkeyPatch()
        self.home = tempfile.TemporaryDirectory()
        self.world = World(self.patch, Path(self.home.name))
        self.asked = set[int]()  # what may be the last number of workers that was asked for

    def teardown(self) -> None:
        if not hasattr(self, "world"):
            return
        try:
            self.world.cloud.unavailable.clear()
            assert self.world.down() == "done"
            assert self.world.left() == Observed()
        finally:
            self.patch.undo()
            self.home.cleanup()

    @rule(
        count=st.integers(0, 3),
        least=st.integers(0, 3),
        market=st.sampled_from(["on_demand", "spot_with_fallback"]),
        fault=FAULTS,
        at=st.integers(1, 25),
    )
    def up(self, count: int, least: int, market: str, fault: str, at: int) -> None:
        least = min(count, least)
        if self.world.up(count, least, market, fault=fault, at=at) != "done":
            self.asked.add(count)
            return
        self.asked = {count}
        nodes = {machine.name.node for machine in self.world.alive()}
        spec = make_spec(count, least)
        assert "head" in nodes
        assert nodes <= set(spec.nodes())
        assert len(nodes) - 1 >= least

    @rule(fault=FAULTS, at=st.integers(1, 12))
    def down(self, fault: str, at: int) -> None:
        if self.world.down(fault=fault, at=at) == "done":
            assert self.world.left() == Observed()

    @rule(node=st.sampled_from(["head", "worker-1", "worker-2"]))
    def interrupt(self, node: str) -> None:
        self.world.cloud.interrupt(node)

    @rule(fault=FAULTS, at=st.integers(1, 10))
    def replace_lost(self, fault: str, at: int) -> None:
        """Whoever watches has read a file that says 3; what counts is what was asked for last."""
        before = {machine.id for machine in self.world.alive()}
        cluster = make_cluster(make_spec(3), self.world.cloud)
        self.world.run(replace_lost, cluster, fault=fault, at=at)
        new = {m.name.node for m in self.world.alive() if m.id not in before}
        assert not new or new <= set(make_spec(max(self.asked)).nodes())

    @rule(kinds=st.sets(st.sampled_from(KINDS)))
    def run_out(self, kinds: set[tuple[str, str]]) -> None:
        self.world.cloud.unavailable = kinds

    @rule(nodes=st.sets(st.sampled_from(["head", "worker-1", "worker-2"]), max_size=1))
    def break_once(self, nodes: set[str]) -> None:
        self.world.set_up.broken_once = nodes

    @rule(seconds=st.sampled_from([1, 10, 600, 3600]))
    def wait(self, seconds: int) -> None:
        self.world.time.advance(seconds)

    @rule()
    def reap_when_all_is_over(self) -> None:
        self.world.time.advance(3 * 3600)
        assert self.world.run(reap, self.world.cloud) == "done"
        assert self.world.left() == Observed()

    @invariant()
    def nobody_else_is_touched(self) -> None:
        if hasattr(self, "world"):
            seen = {m.id: m for m in self.world.cloud.observe("foreign").machines}
            foreign = self.world.foreign
            assert foreign.id not in seen or seen[foreign.id].lease_until == foreign.lease_until

    @invariant()
    def no_node_has_two_machines(self) -> None:
        if hasattr(self, "world"):
            self.world.check_no_duplicate()


TestClusterLife = ClusterLife.TestCase
TestClusterLife.settings = settings(
    max_examples=40,
    stateful_step_count=25,
    phases=[Phase.explicit, Phase.reuse, Phase.generate],  # shrinking takes minutes
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["up", "down"])
@pytest.mark.parametrize("market", ["on_demand", "spot_with_fallback"])
def test_a_command_killed_at_every_call_in_turn_leaves_no_orphan_and_no_duplicate(
    verb: str, market: str, tmp_path: Path
) -> None:
    """Kill `up` before and after each call, then `up` again or `down`."""
    for at in itertools.count(1):
        with pytest.MonkeyPatch.context() as patch:
            world = World(patch, tmp_path / f"{verb}-{at}")
            world.cloud.unavailable = {("c6i.xlarge", "spot"), ("c6i.xlarge", "on_demand")}
            end = world.up(2, 2, market, fault="killed", at=at)
            world.cloud.unavailable.clear()
            if verb == "up":
                assert world.up(2, 2, market) == "done"
                nodes = sorted(machine.name.node for machine in world.alive())
                assert nodes == ["head", "worker-1", "worker-2"]
            assert world.down() == "done"
            assert world.left() == Observed()
        if end == "done":
            break
    assert at > 30


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["error", "lost answer", "killed"])
@pytest.mark.parametrize("verb", ["up", "replace_lost"])
def test_what_a_command_has_launched_is_known_to_the_next_one_however_it_ended(
    verb: str, fault: str, tmp_path: Path
) -> None:
    """The machine of a lost worker is not listed yet when the next `up` wants no workers."""
    for at in itertools.count(1):
        with pytest.MonkeyPatch.context() as patch:
            world = World(patch, tmp_path / str(at))
            assert world.up(3, 3, "on_demand") == "done"
            world.cloud.interrupt("worker-2")
            world.time.advance(60)
            if verb == "up":
                world.up(3, 0, "on_demand", fault=fault, at=at)
            else:
                cluster = make_cluster(make_spec(3), world.cloud)
                world.run(replace_lost, cluster, fault=fault, at=at)
            has_struck = world.countdown == 0
            assert world.up(0, 0, "on_demand") == "done"
            assert [machine.name.node for machine in world.alive()] == ["head"]
        if not has_struck:
            break
    assert at > 5


@pytest.mark.parametrize("fault", ["error", "lost answer"])
def test_an_up_that_fails_leaves_the_cluster_as_it_was(fault: str, tmp_path: Path) -> None:
    """A machine whose launch was not answered is taken away too, though it is listed late."""
    failed = 0
    for at in itertools.count(1):
        with pytest.MonkeyPatch.context() as patch:
            world = World(patch, tmp_path / str(at))
            assert world.up(1, 1, "on_demand") == "done"
            before = {machine.id for machine in world.alive()}
            end = world.up(2, 2, "on_demand", fault=fault, at=at)
            if world.countdown:
                break
            if end == "failed":
                failed += 1
                assert {machine.id for machine in world.alive()} == before
    assert failed > 3
