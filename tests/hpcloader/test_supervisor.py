"""The supervisor under thousands of random lives of a component, without a process or a clock."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hpcloader.supervisor import (
    Action,
    AskToEnd,
    ComponentState,
    End,
    Kill,
    RestartRule,
    Start,
    Supervisor,
)

RULE = RestartRule(first_s=1.0, cap_s=8.0, give_up_after=4, quick_s=10.0, grace_s=5.0)


class World:
    """A component as the supervisor's actions make it, and what must hold after each of them."""

    def __init__(self, rule: RestartRule) -> None:
        self.rule = rule
        self.supervisor = Supervisor(rule)
        self.now = 0.0
        self.is_alive = False
        self.is_wanted = True
        self.end: End | None = None
        self.starts: list[float] = []
        self.exits: list[float] = []
        self.signals: list[Action] = []
        self.actions: list[Action] = []

    def apply(self, actions: list[Action]) -> None:
        for action in actions:
            assert self.end is None, "nothing may follow the end"
            match action:
                case Start():
                    assert not self.is_alive
                    assert self.is_wanted
                    self.is_alive = True
                    self.starts.append(self.now)
                case AskToEnd() | Kill():
                    assert self.is_alive
                    self.signals.append(action)
                case End():
                    assert not self.is_alive
                    self.end = action
        self.actions += actions
        self.check()

    def check(self) -> None:
        state = self.supervisor.state
        living = (ComponentState.RUNNING, ComponentState.STOPPING, ComponentState.KILLING)
        assert self.is_alive == (state in living)
        assert (self.end is not None) == (state is ComponentState.ENDED)
        waiting = (ComponentState.WAITING, ComponentState.STOPPING)
        assert (self.supervisor.deadline is not None) == (state in waiting)
        assert self.signals in ([], [AskToEnd()], [AskToEnd(), Kill()])

    def start(self) -> None:
        self.apply(self.supervisor.start(self.now))

    def leave(self, code: int) -> None:
        if self.is_alive:
            self.is_alive = False
            self.exits.append(self.now)
            self.apply(self.supervisor.exited(self.now, code))

    def stop(self, grace_s: float | None = None) -> None:
        self.is_wanted = False
        self.apply(self.supervisor.stop(self.now, grace_s))

    def wait(self, seconds: float) -> None:
        """Let time pass as the daemon does: a tick at every deadline."""
        until = self.now + seconds
        while self.supervisor.deadline is not None and self.supervisor.deadline <= until:
            self.now = max(self.now, self.supervisor.deadline)
            self.apply(self.supervisor.tick(self.now))
        self.now = until
        self.apply(self.supervisor.tick(self.now))


events = st.one_of(
    st.tuples(st.just("leave"), st.sampled_from([0, 0, 1, 1, 1, -9, -15, 127])),
    st.tuples(st.just("leave"), st.sampled_from([1, 2])),
    st.tuples(st.just("wait"), st.floats(0.0, 40.0)),
    st.tuples(st.just("wait"), st.sampled_from([0.0, 1.0, 2.0, 8.0])),
    st.tuples(st.just("start"), st.just(0)),
    st.tuples(st.just("stop"), st.sampled_from([None, 0.0, 1.0])),
)


@pytest.mark.slow
@settings(max_examples=2000, deadline=None)
@given(st.lists(events, max_size=40), st.booleans())
def test_no_life_of_a_component_breaks_the_rules(
    script: list[tuple[str, float]], is_stopped: bool
) -> None:
    world = World(RULE)
    world.start()
    for name, value in script:
        match name:
            case "leave":
                world.leave(int(value))
            case "wait":
                world.wait(value)
            case "start":
                world.start()
            case "stop":
                world.stop(value)
    if is_stopped:
        world.stop()
        world.wait(RULE.grace_s)
        assert not world.is_alive or Kill() in world.signals
        world.leave(-9)
        assert world.end is not None
    for exit_at, start_at in zip(world.exits, world.starts[1:], strict=False):
        assert RULE.first_s <= start_at - exit_at + 1e-6
        assert start_at - exit_at <= RULE.cap_s + 1e-6


@settings(max_examples=500, deadline=None)
@given(
    st.floats(0.01, 10.0),
    st.floats(0.01, 1000.0),
    st.integers(1, 12),
    st.floats(0.0, 9.9),
)
def test_delays_double_up_to_the_cap_and_then_it_gives_up(
    first_s: float, cap_s: float, give_up_after: int, lived_s: float
) -> None:
    rule = RestartRule(first_s, max(first_s, cap_s), give_up_after, quick_s=10.0)
    world = World(rule)
    world.start()
    for _ in range(give_up_after):
        assert world.end is None
        world.wait(lived_s)
        world.leave(1)
        world.wait(rule.cap_s)
        if world.is_alive:  # the wait may have outlived the delay: begin a life of known length
            world.supervisor._started = world.now
    assert world.end is not None
    assert world.end.exit_code == 1
    assert f"failed {give_up_after} times" in world.end.complaint
    delays = [rule.delay(k) for k in range(1, give_up_after + 1)]
    assert delays[0] == rule.first_s
    assert all(b in (2 * a, rule.cap_s) for a, b in pairwise(delays))


def test_a_long_run_clears_the_count() -> None:
    world = World(RULE)
    world.start()
    for _ in range(20):
        for _ in range(RULE.give_up_after - 1):
            world.leave(1)
            world.now = world.supervisor.deadline or world.now
            world.wait(0.0)
        world.wait(RULE.quick_s)
    assert world.end is None
    assert world.is_alive


def test_a_clean_exit_is_no_failure_but_slows_the_starts() -> None:
    world = World(RULE)
    world.start()
    delays = []
    for _ in range(3 * RULE.give_up_after):
        world.leave(0)
        assert world.supervisor.deadline is not None
        delays.append(world.supervisor.deadline - world.now)
        world.wait(delays[-1])
    assert world.is_alive
    assert delays[:4] == [1.0, 2.0, 4.0, 8.0]
    assert set(delays[4:]) == {8.0}


def test_a_wrong_configuration_is_not_tried_again() -> None:
    world = World(RULE)
    world.start()
    world.leave(2)
    assert world.end is not None
    assert world.end.exit_code == 2
    assert "configuration" in world.end.complaint


@pytest.mark.parametrize(("grace_s", "killed_after"), [(None, 5.0), (1.0, 1.0)])
def test_a_component_that_does_not_leave_is_killed(
    grace_s: float | None, killed_after: float
) -> None:
    world = World(RULE)
    world.start()
    world.stop(grace_s)
    world.wait(killed_after - 0.1)
    assert world.signals == [AskToEnd()]
    world.wait(0.2)
    assert world.signals == [AskToEnd(), Kill()]


def test_a_lost_master_shortens_the_grace_of_a_stop() -> None:
    world = World(RULE)
    world.start()
    world.stop()
    world.stop(1.0)
    assert world.supervisor.deadline == 1.0


def test_a_huge_count_of_quick_ends_does_not_overflow() -> None:
    assert RULE.delay(10**6) == RULE.cap_s
