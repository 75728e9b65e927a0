"""Two users, one name of a cluster: nobody's healthy machine is ever lost, whatever is done.

Anna has made a cluster. Ben has a cluster file of the same name, the same cloud and no key of
hers; Clara has her key. They run every command, at any call of one another's commands.
"""

from __future__ import annotations

import itertools
import os
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from simulated import Keyring, SimulatedTime, make_cluster, make_spec
from simulated.memory import MemoryProvider

from hpccomponent.errors import CloudError
from hpcdeploy.provider import MachineSeen, State
from hpcdeploy.reconcile.cluster import Cluster
from hpcdeploy.reconcile.converge import bring_up, look_ahead, replace_lost, take_down
from hpcdeploy.reconcile.reap import reap
from hpcdeploy.spec.cluster import ClusterSpec

LIVE = (State.PENDING, State.RUNNING)
GRACE = timedelta(minutes=5)
USERS = st.sampled_from(["anna", "ben", "clara"])
FAULTS = st.sampled_from(["none", "none", "none", "error", "lost answer", "killed", "ctrl-c"])
VERBS = st.sampled_from(["up", "scale down", "replace_lost", "reap", "plan", "down"])


class Killed(BaseException):
    """Ends a command like kill -9: nothing of ours may catch it."""


class WatchedCloud(MemoryProvider):
    """A cloud that remembers who has ended which machines, as they were."""

    def __init__(self, now: Any) -> None:
        super().__init__(now, boot_s=30, end_s=20, unseen_s=4)
        self.user = ""
        self.ended: list[tuple[str, MachineSeen]] = []

    def terminate(self, machines: Sequence[MachineSeen]) -> None:
        ids = {machine.id for machine in machines}
        seen = [self._seen(m) for m in self._machines.values() if m.seen.id in ids]
        self.ended += [(self.user, machine) for machine in seen if machine.state in LIVE]
        super().terminate(machines)


class Lab:
    """A cloud and its users, each with a home; whose command runs is who the process is."""

    def __init__(self, patch: pytest.MonkeyPatch, home: Path) -> None:
        self.home, self.time = home, SimulatedTime()
        self.cloud = WatchedCloud(self.time.now)
        self.cloud.hook = self.strike
        self.unreachable: set[tuple[str, str]] = set()  # a user, and a node that gives no answer
        self.healthy: dict[str, str] = {}  # machines that were set up, and the key that was used
        self.fault, self.countdown, self.is_dead = "none", 0, False
        self.guest: tuple[str, str] | None = None
        self.struck = ""  # the call that the last fault came about at
        patch.setattr("hpcdeploy.install.bootstrap.set_up", self.set_up)
        patch.setattr("hpcdeploy.install.user_data.user_data", lambda *about: "#!")

    def cluster(self, user: str, count: int = 1) -> Cluster:
        key = "ssh-rsa anna" if user in ("anna", "clara") else None
        return make_cluster(make_spec(count, 0), self.cloud, f"{user}@{user}s-laptop", key)

    def set_up(
        self, spec: ClusterSpec, machines: Sequence[MachineSeen], access: Keyring, report: Any
    ) -> dict[str, str]:
        """Let in whoever has the key that a machine was launched with."""
        key = access.ownership().owner.key
        failures: dict[str, str] = {}
        for machine in machines:
            launched = next(
                m.seen.owner for m in self.cloud._machines.values() if m.seen.id == machine.id
            )
            if launched.key != key:
                failures[machine.id] = "permission denied"
            elif (self.cloud.user, machine.name.node) in self.unreachable:
                failures[machine.id] = "no answer"
            else:
                self.healthy[machine.id] = key
        self.strike("before", "set_up")
        return failures

    def strike(self, moment: str, call: str) -> None:
        """Let the armed fault, or the guest's command, come about at the call it was armed for."""
        if self.is_dead:
            raise Killed
        wanted = "after" if self.fault == "lost answer" else "before"
        if self.fault == "none" or moment != wanted:
            return
        self.countdown -= 1
        if self.countdown or threading.current_thread() is not threading.main_thread():
            return
        fault, self.fault, self.struck = self.fault, "none", call
        if fault == "guest":
            assert self.guest is not None
            guest, self.guest = self.guest, None
            self.run(*guest)
        elif fault == "ctrl-c":
            raise KeyboardInterrupt
        else:
            self.is_dead = fault == "killed"
            raise Killed if self.is_dead else CloudError(f"{call}: injected")

    @contextmanager
    def as_user(self, user: str) -> Iterator[None]:
        before = self.cloud.user, os.environ.get("XDG_STATE_HOME", "")
        self.cloud.user, os.environ["XDG_STATE_HOME"] = user, str(self.home / user)
        try:
            yield
        finally:
            self.cloud.user, os.environ["XDG_STATE_HOME"] = before

    def run(self, user: str, verb: str, fault: str = "none", at: int = 1, count: int = 1) -> str:
        """Run a user's verb; return how it ended."""
        self.fault, self.countdown, self.is_dead = fault, at, False
        try:
            with self.as_user(user):
                self.do(self.cluster(user, 0 if verb == "scale down" else count), verb)
        except Killed:
            return "killed"
        except KeyboardInterrupt:
            return "ctrl-c"
        except CloudError:
            return "failed"
        finally:
            self.fault, self.is_dead = "none", False
        return "done"

    def do(self, cluster: Cluster, verb: str) -> None:
        polling, say = self.time.polling(), lambda line: None
        match verb:
            case "plan":
                look_ahead(cluster)
            case "reap":
                reap(self.cloud, say, polling)
            case "replace_lost":
                replace_lost(cluster, say, polling=polling)
            case "down":
                take_down(cluster, say, polling=polling)
            case _:
                bring_up(cluster, say, polling=polling)

    def needed(self) -> set[str]:
        """Return the machines that work, and have their node's name to themselves."""
        machines = [self.cloud._seen(machine) for machine in self.cloud._machines.values()]
        live = [machine for machine in machines if machine.state in LIVE]
        lives = {group.incarnation for group in self.cloud.observe("bunny").lives}
        names = Counter(machine.name.node for machine in live)
        return {
            machine.id
            for machine in live
            if machine.id in self.healthy
            and machine.incarnation in lives
            and names[machine.name.node] == 1
        }

    def check(self) -> None:
        """Nobody has ended another's machine that was in its lease; nobody an own one in use."""
        for user, machine in self.cloud.ended:
            key = self.cluster(user).access.public  # type: ignore[attr-defined]
            with self.as_user(user):
                ownership = self.cluster(user).access.ownership().owner.key
            is_own = machine.owner.user.startswith(user) or (key and machine.owner.key == ownership)
            is_over = machine.lease_until and machine.lease_until + GRACE < self.time.now()
            assert is_own or is_over, (user, machine)
        self.cloud.ended.clear()


def folder_in_memory() -> tempfile.TemporaryDirectory[str]:
    shm = "/dev/shm"  # noqa: S108 - the journal syncs every line
    return tempfile.TemporaryDirectory(dir=shm if os.path.isdir(shm) else None)


class TwoUsers(RuleBasedStateMachine):
    """Commands of three users in any order, and inside one another."""

    @initialize(first=st.sampled_from(["anna", "ben"]))
    def begin(self, first: str) -> None:
        self.patch = pytest.MonkeyPatch()
        self.patch.setenv("XDG_STATE_HOME", "/nowhere")
        self.home = folder_in_memory()
        self.lab = Lab(self.patch, Path(self.home.name))
        self.lab.run(first, "up", count=2)

    def teardown(self) -> None:
        if hasattr(self, "lab"):
            self.patch.undo()
            self.home.cleanup()

    @rule(user=USERS, verb=VERBS, fault=FAULTS, at=st.integers(1, 20), count=st.integers(0, 2))
    def command(self, user: str, verb: str, fault: str, at: int, count: int) -> None:
        self.lab.run(user, verb, fault, at, count)

    @rule(user=USERS, verb=VERBS, guest=USERS, its=VERBS, at=st.integers(1, 15))
    def commands_inside_one_another(
        self, user: str, verb: str, guest: str, its: str, at: int
    ) -> None:
        self.lab.guest = (guest, its)
        self.lab.run(user, verb, "guest", at)

    @rule(node=st.sampled_from(["head", "worker-1"]))
    def lose(self, node: str) -> None:
        self.lab.cloud.interrupt(node)

    @rule(user=USERS, verb=st.sampled_from(["up", "replace_lost"]),
          nodes=st.sets(st.sampled_from(["head", "worker-1"]), min_size=1))  # fmt: skip
    def command_without_an_answer(self, user: str, verb: str, nodes: set[str]) -> None:
        """A machine that has worked and does not let us in now is never ended for it."""
        needed = self.lab.needed()
        self.lab.unreachable = {(user, node) for node in nodes}
        self.lab.run(user, verb, count=2)
        self.lab.unreachable = set()
        assert needed.isdisjoint(machine.id for _, machine in self.lab.cloud.ended)

    @rule(seconds=st.sampled_from([1, 10, 600, 3600]))
    def wait(self, seconds: int) -> None:
        self.lab.time.advance(seconds)

    @invariant()
    def nobodys_healthy_machine_is_lost(self) -> None:
        if hasattr(self, "lab"):
            self.lab.check()


@pytest.mark.parametrize("its", ["up", "scale down"])
@pytest.mark.parametrize("verb", ["up", "scale down", "replace_lost"])
def test_the_last_number_of_workers_holds_whatever_runs_inside_what(
    verb: str, its: str, tmp_path: Path
) -> None:
    """Anna and Clara share a key, and no lock: Clara's command runs at each of Anna's calls."""
    for at in itertools.count(1):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("XDG_STATE_HOME", "/nowhere")
            lab = Lab(patch, tmp_path / str(at))
            assert lab.run("anna", "up", count=2) == "done"
            lab.cloud.interrupt("worker-1")
            lab.time.advance(60)
            lab.guest = ("clara", its)
            lab.run("anna", verb, "guest", at, count=3)
            if lab.guest is not None and lab.countdown > 0:  # there are no more calls
                break
            if lab.guest is not None:  # the call is one of a thread
                continue
            lab.time.advance(60)
            seen = lab.cloud.observe("bunny")
            desired = seen.desired("bunny")
            assert desired is not None
            alive = {machine.name.node for machine in seen.machines if machine.state in LIVE}
            assert alive == set(make_spec(desired.workers).nodes()), at
            assert lab.run("clara", "replace_lost", count=3) == "done"
            assert lab.healthy.keys() >= {m.id for m in seen.machines if m.state in LIVE}
    assert at > 3


def lose_a_worker(lab: Lab) -> None:
    """Have Clara make a cluster and lose a worker, and get no answer of the next one."""
    lab.run("clara", "up", count=2)
    lab.cloud.interrupt("worker-1")
    lab.time.advance(60)
    lab.unreachable = {("clara", "worker-1")}


@pytest.mark.parametrize("annas", [4, 99], ids=["she is killed when it is set up", "she lives"])
def test_a_machine_that_another_has_set_up_is_not_ended_by_who_launched_it(
    monkeypatch: pytest.MonkeyPatch, annas: int
) -> None:
    """Clara launches it, gets no answer and is killed at any call; Anna gets one."""
    monkeypatch.setenv("XDG_STATE_HOME", "/nowhere")
    for at in itertools.count(1):
        with folder_in_memory() as home:
            lab = Lab(monkeypatch, Path(home))
            lose_a_worker(lab)
            lab.run("clara", "replace_lost", "killed", at, count=2)
            if lab.countdown > 0:  # there are no more calls
                break
            lab.run("anna", "up", "killed", annas, count=2)
            needed = lab.needed()
            lab.cloud.ended.clear()
            lab.run("clara", "up", count=2)
            assert needed.isdisjoint(machine.id for _, machine in lab.cloud.ended), at
    assert at > 10


def test_a_machine_that_another_sets_up_meanwhile_is_not_ended_by_who_launched_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Anna's command runs at each of Clara's calls, and gets the answer that Clara does not."""
    monkeypatch.setenv("XDG_STATE_HOME", "/nowhere")
    calls: set[str] = set()
    for at in itertools.count(1):
        with folder_in_memory() as home:
            lab = Lab(monkeypatch, Path(home))
            lose_a_worker(lab)
            lab.guest = ("anna", "up")
            lab.run("clara", "replace_lost", "guest", at, count=2)
            if lab.guest is not None and lab.countdown > 0:
                break
            if lab.guest is None and lab.struck != "terminate":  # by then it is decided
                calls.add(lab.struck)
                ended = {machine.id for user, machine in lab.cloud.ended if user == "clara"}
                assert ended.isdisjoint(lab.healthy), at
    assert calls >= {"observe", "set_up"}


class ManySchedules(TwoUsers):
    """The same, over and over."""


def schedules(count: int) -> settings:
    return settings(
        max_examples=count,
        stateful_step_count=20,
        phases=[Phase.explicit, Phase.reuse, Phase.generate],  # shrinking takes minutes
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )


TestTwoUsers = TwoUsers.TestCase
TestTwoUsers.settings = schedules(60)

TestManySchedules = pytest.mark.long(pytest.mark.timeout(1800)(ManySchedules.TestCase))
TestManySchedules.settings = schedules(1000)
