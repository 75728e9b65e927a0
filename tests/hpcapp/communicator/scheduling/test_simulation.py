"""The scheduler and real worker sessions on a simulated network, under thousands of faults."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from random import Random
from unittest import TestCase

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
)

from hpcapp.communicator.fetching import Fetcher, TakeBuffers
from hpcapp.communicator.scheduling.dispatching import CREDIT
from hpcapp.communicator.scheduling.losses import LOSS_BUDGET
from hpcapp.communicator.scheduling.policy import AdaptivePolicy, EqualPolicy, Policy, PullPolicy
from hpcapp.communicator.scheduling.scheduler import Scheduler
from hpcapp.communicator.scheduling.state import Action as SchedulerAction
from hpcapp.communicator.scheduling.state import (
    AskRegister,
    Assign,
    Deliver,
    Dismiss,
    Fail,
    Forgotten,
    Refuse,
    Task,
    Welcome,
)
from hpcapp.communicator.scheduling.verification import Verification, digest_answer
from hpccomponent.clock import ManualClock
from hpccomponent.errors import DistrustError, NoWorkersError, ProtocolError, WorkerLostError
from hpccomponent.protocol.blobs import Blob
from hpccomponent.protocol.frames import Buffer
from hpccomponent.protocol.messages import (
    PROTOCOL_VERSION,
    Announce,
    Batch,
    Call,
    ComponentMessage,
    Drain,
    Failure,
    Forget,
    Goodbye,
    Heartbeat,
    Lost,
    MasterMessage,
    Need,
    Piece,
    Ping,
    Refused,
    Register,
    RegisterAgain,
    Registered,
    Result,
    Results,
    Share,
    encode_message,
)
from hpccomponent.protocol.parcels import LARGE_BYTES
from hpccomponent.protocol.session import (
    Action,
    Discard,
    Keep,
    RunBatch,
    Send,
    SessionState,
    StartWorker,
    WorkerSession,
)

SESSION = "simulated"
BLOBS = [Blob(number.to_bytes(16, "little"), b"", (), 1000) for number in range(6)]
POLICIES = [EqualPolicy(), PullPolicy(), AdaptivePolicy()]
KEPT_BYTES = 2000  # of blobs, by a component
LIMIT = LARGE_BYTES + 1000  # of a result: every tenth is so large, and fetched
ZEROS = {3: bytes(LIMIT - 8), 7: bytes(LARGE_BYTES // 2)}


def value_of(task: int) -> memoryview:
    """Return the buffer of a task's result."""
    return memoryview(task.to_bytes(8, "little") + ZEROS.get(task % 10, b""))


Outcome = Result | BaseException


def written_in(outcome: Outcome) -> int:
    """Return what a task has written."""
    assert isinstance(outcome, Result)
    return outcome.written


@dataclass(eq=False)
class Component:
    """A session with its worker process, and what is on its way to and from it."""

    identity: bytes
    key: str
    session: WorkerSession
    down: deque[MasterMessage] = field(default_factory=deque)
    up: deque[tuple[ComponentMessage, Sequence[Buffer]]] = field(default_factory=deque)
    work: deque[tuple[Batch, int]] = field(default_factory=deque)
    kept: set[bytes] = field(default_factory=set)
    in_worker: set[bytes] = field(default_factory=set)
    is_frozen: bool = False
    is_bad: bool = False
    is_sick: bool = False
    lie: int = 0

    def carry_out(self, actions: Sequence[Action]) -> None:
        for action in actions:
            if isinstance(action, Send):
                self.up.append((action.message, action.buffers))
            elif isinstance(action, RunBatch):
                assert self.kept.issuperset(action.blobs), "a blob to be handed over is not kept"
                self.in_worker.update(action.blobs)
                self.work.append((action.batch, 0))
            elif isinstance(action, Keep):
                assert action.blob.key not in self.kept
                self.kept.add(action.blob.key)
            elif isinstance(action, Discard):
                self.kept.difference_update(action.keys)
                self.in_worker.difference_update(action.keys)
            elif isinstance(action, StartWorker):
                self.in_worker.clear()
                self.carry_out(self.session.worker_started())


class Cluster:
    """A master's scheduler, components, and the network between them."""

    def __init__(self, policy: Policy, verification: Verification | None = None) -> None:
        self.clock = ManualClock()
        self.cancelled: set[int] = set()
        self.names: dict[str, str] = {}
        self.scheduler = Scheduler(
            policy, self.clock, "1", self.claim, verification=verification, names=self.names
        )
        self.fetcher = Fetcher(SESSION)
        self.components: list[Component] = []
        self.calls: dict[int, Call] = {}
        self.ended: dict[int, Outcome] = {}
        self.deliveries: Counter[int] = Counter()
        self.assigned: Counter[int] = Counter()
        self.runs: Counter[int] = Counter()
        self.started = 0

    def claim(self, number: int) -> bool:
        return number not in self.cancelled

    def submit(self, count: int) -> None:
        for _ in range(count):
            number = len(self.calls)
            blobs = (
                tuple(BLOBS[i] for i in {number // 7 % 6, number // 3 % 6}) if number % 5 else ()
            )
            keys = [blob.key for blob in blobs]
            self.calls[number] = Call(number, "simulated.task", b"", [], keys)
            self.carry_out(
                self.scheduler.submit(
                    Task(number, "simulated.task", 1000, blobs, limit_bytes=LIMIT)
                )
            )
        self.carry_out(self.scheduler.dispatch())

    def cancel(self, number: int) -> None:
        task = self.scheduler.tasks.get(number)
        if task is not None and not task.is_claimed:
            self.cancelled.add(number)
            self.carry_out(self.scheduler.cancel(number))

    def start_component(self, name: str | None = None, key: str | None = None) -> Component:
        """Start one under a key of its own, which gets its name, or under one that has a name."""
        self.started += 1
        name = name or f"worker-{self.started}"
        key = key or f"key of {name}"
        self.names.setdefault(key, name)
        register = Register(
            PROTOCOL_VERSION, "1", name, str(self.started), "b", "n", 1, 1, 1 << 20, KEPT_BYTES
        )
        session = WorkerSession(register, self.clock.now())
        component = Component(f"{name}/{self.started}".encode(), key, session)
        self.components.append(component)
        component.carry_out(session.begin())
        return component

    def start_components(self, count: int) -> list[Component]:
        """Start some, and register them."""
        components = [self.start_component() for _ in range(count)]
        for component in components:
            self.pump(component, 10)
        return components

    def carry_out(self, actions: Sequence[SchedulerAction]) -> None:
        for action in actions:
            if isinstance(action, Deliver):
                self.end(action.task, action.result)
            elif isinstance(action, Fail):
                self.end(action.task, action.error)
            elif isinstance(action, Assign):
                self.assigned.update(action.tasks)
                for blob in action.blobs:
                    self.send(action.worker, Share(SESSION, blob.key, b"", [blob.size_bytes]))
                calls = [self.calls[number] for number in action.tasks]
                self.send(action.worker, Batch(SESSION, action.batch, calls))
            elif isinstance(action, Forgotten):
                self.send(action.worker, Forget(SESSION, [action.key]))
            elif isinstance(action, Welcome):
                self.send(action.worker, Registered(SESSION, 1.0, 60.0, 1 << 20))
            elif isinstance(action, Refuse):
                self.send(action.worker, Refused(action.reason))
            elif isinstance(action, AskRegister):
                self.send(action.worker, RegisterAgain())
            elif isinstance(action, Dismiss):
                self.send(action.worker, Drain(SESSION))

    def end(self, number: int, outcome: Outcome) -> None:
        assert number not in self.ended, "a task ended twice"
        assert number not in self.cancelled, "a cancelled task ended"
        self.ended[number] = outcome

    def send(self, identity: bytes, message: MasterMessage) -> None:
        for component in self.components:
            if component.identity == identity:
                component.down.append(message)

    def pump(self, component: Component, count: int) -> None:
        """Let `count` messages through in each direction."""
        for _ in range(min(count, len(component.up))):
            self.judge(component, *component.up.popleft())
        for _ in range(0 if component.is_frozen else min(count, len(component.down))):
            message = component.down.popleft()
            component.carry_out(component.session.receive(message, (), self.clock.now()))
        if component.session.state is SessionState.STOPPED:
            component.work.clear()

    def judge(
        self, component: Component, message: ComponentMessage, buffers: Sequence[Buffer]
    ) -> None:
        scheduler, identity = self.scheduler, component.identity
        if isinstance(message, Register):
            self.carry_out(scheduler.register(identity, message, component.key))
        elif isinstance(message, Results | Announce | Piece | Lost):
            self.take(identity, message, buffers)
        elif isinstance(message, Heartbeat):
            if identity in scheduler.workers:
                self.fetcher.heartbeat(identity, message)
            held = [*message.held, *self.fetcher.batches(identity)]
            self.carry_out(
                scheduler.heartbeat(identity, message.progress, message.last_batch, held)
            )
        elif isinstance(message, Need):
            self.carry_out(scheduler.need(identity, message.batch, message.keys))
        elif isinstance(message, Goodbye):
            self.carry_out(scheduler.goodbye(identity, message.reason))
        self.ask(identity)

    def take(
        self,
        identity: bytes,
        message: Results | Announce | Piece | Lost,
        buffers: Sequence[Buffer],
    ) -> None:
        """Take what has to do with results in order, as the event loop does."""
        worker, fetcher = self.scheduler.workers.get(identity), self.fetcher
        if isinstance(message, Results | Lost) and not fetcher.is_fetching(identity):
            self.hear_results(identity, message, lambda _: buffers)
            if isinstance(message, Results) and worker is not None:
                fetcher.note_taken(identity, message, sum(map(len, buffers)))
            return
        if worker is None:
            self.carry_out([AskRegister(identity)])
            return
        if isinstance(message, Announce):
            assignments = self.scheduler.dispatcher.assignments
            limits = assignments.most_bytes(
                worker, message.batch, message.tasks, self.scheduler.tasks
            )
            fetcher.announce(identity, message, limits)
        elif isinstance(message, Piece):
            asked = fetcher.take(identity, message.fetch)
            if asked is not None:
                asked.fill(buffers)
        else:
            fetcher.wait(identity, message, buffers)
        self.ask(identity)
        for complete, take_buffers in fetcher.complete(identity):
            self.hear_results(identity, complete, take_buffers)

    def ask(self, identity: bytes) -> None:
        for request in self.fetcher.requests(identity):
            self.send(identity, request)

    def hear_results(
        self, identity: bytes, message: Results | Lost, take_buffers: TakeBuffers
    ) -> None:
        """Check and take results, as the event loop does."""
        scheduler, worker = self.scheduler, self.scheduler.workers.get(identity)
        if isinstance(message, Lost):
            self.carry_out(
                scheduler.batch_lost(identity, message.batch, message.reason, message.is_blamed)
            )
            return
        numbers = [result.task for result in message.results]
        if worker is not None:
            try:
                scheduler.dispatcher.assignments.most_bytes(
                    worker, message.batch, numbers, scheduler.tasks
                )
                if any(result.header for result in message.results):
                    raise ProtocolError("the value is not what it must be")
            except ProtocolError as error:
                self.carry_out(scheduler.expose(identity, error.problem))
                return
            values = take_buffers([size for result in message.results for size in result.sizes])
            for number, value in zip(numbers, values, strict=False):
                assert value == value_of(number), "the result of another task"
        self.carry_out(
            scheduler.results(
                identity,
                message.batch,
                message.results,
                message.is_finished,
                lambda index: digest_answer(message.results[index], ()),
            )
        )

    def work(self, component: Component) -> None:
        """Run one task, and send its result."""
        if component.is_frozen or not component.work:
            return
        if component.is_bad:
            self.crash_worker(component)
            return
        batch, index = component.work.popleft()
        call = batch.calls[index]
        self.runs[call.task] += 1
        assert component.in_worker.issuperset(call.blobs), "a task runs without its blob"
        is_last = index + 1 == len(batch.calls)
        if not is_last:
            component.work.appendleft((batch, index + 1))
        failure = (
            Failure("ImportError", "a library is broken", "", "") if component.is_sick else None
        )
        value = memoryview(b"") if failure else value_of(call.task)
        sizes = [] if failure else [len(value)]
        results = [Result(call.task, 0.001, b"", sizes, failure, call.task + component.lie)]
        message = Results(batch.session, batch.batch, results, is_last)
        component.carry_out(
            component.session.worker_results(
                message, encode_message(message), value, self.clock.now()
            )
        )

    def crash_worker(self, component: Component) -> None:
        if component.is_frozen or component.session.state is SessionState.STOPPED:
            return
        component.work.clear()
        component.carry_out(component.session.worker_died("it crashed"))

    def kill(self, component: Component) -> None:
        """Let a component vanish with all that is on its way to it."""
        self.components.remove(component)
        self.carry_out(self.scheduler.disconnected([component.identity], "its connection broke"))

    def leave(self, component: Component) -> None:
        """Let a component leave without a word that is held against anything."""
        self.carry_out(self.scheduler.goodbye(component.identity, "it was told to"))

    def pass_time(self, seconds: float) -> None:
        self.clock.advance(seconds)
        for component in list(self.components):
            if not component.is_frozen:
                component.carry_out(component.session.tick(self.clock.now()))
        self.carry_out(self.scheduler.tick())
        self.fetcher.retain(self.scheduler.workers)
        last_batch = self.scheduler.dispatcher.assignments.last
        for identity in self.scheduler.workers:
            self.send(identity, Ping(SESSION, last_batch, self.fetcher.last))

    def work_off(self, component: Component) -> None:
        """Let all messages through, and all tasks run that have come."""
        self.pump(component, 1000)
        while component.work:
            self.work(component)
        self.pump(component, 1000)

    def settle(self) -> None:
        """End all faults, and work on until nothing moves."""
        self.components = [
            c for c in self.components if c.session.state is not SessionState.STOPPED
        ]
        for component in self.components:
            component.is_frozen = False
        self.start_component()
        for _ in range(600):  # with room for two blobs only, most batches are put back once
            for component in list(self.components):
                self.work_off(component)
            if not self.scheduler.tasks:
                return
            self.pass_time(1.0)


class FaultyCluster(RuleBasedStateMachine):
    """Every rule is an event of normal life, or a fault."""

    policy: Policy = PullPolicy()
    which = st.integers(min_value=0, max_value=1000)

    def __init__(self) -> None:
        super().__init__()
        self.cluster = Cluster(self.policy)
        self.cluster.pump(self.cluster.start_component(), 10)

    def pick(self, which: int) -> Component:
        return self.cluster.components[which % len(self.cluster.components)]

    @rule(count=st.integers(min_value=1, max_value=100))
    def submit(self, count: int) -> None:
        self.cluster.submit(count)

    @rule(which=which)
    @precondition(lambda self: self.cluster.calls)
    def cancel(self, which: int) -> None:
        self.cluster.cancel(which % len(self.cluster.calls))

    @rule()
    @precondition(lambda self: len(self.cluster.components) < 5)
    def start_component(self) -> None:
        self.cluster.start_component()

    @rule(which=which)
    @precondition(lambda self: self.cluster.components)
    def start_anew(self, which: int) -> None:
        self.cluster.start_component(self.pick(which).session._register.worker)

    @rule(which=which, count=st.integers(min_value=1, max_value=5))
    @precondition(lambda self: self.cluster.components)
    def pump(self, which: int, count: int) -> None:
        self.cluster.pump(self.pick(which), count)

    @rule(which=which, count=st.integers(min_value=1, max_value=30))
    @precondition(lambda self: self.cluster.components)
    def work(self, which: int, count: int) -> None:
        for _ in range(count):
            self.cluster.work(self.pick(which))

    @rule(seconds=st.sampled_from([0.1, 1.0, 5.0]))
    def pass_time(self, seconds: float) -> None:
        self.cluster.pass_time(seconds)

    @rule(which=which)
    @precondition(lambda self: self.cluster.components)
    def crash_worker(self, which: int) -> None:
        self.cluster.crash_worker(self.pick(which))

    @rule(which=which)
    @precondition(lambda self: self.cluster.components)
    def kill(self, which: int) -> None:
        self.cluster.kill(self.pick(which))

    @rule(which=which)
    @precondition(lambda self: self.cluster.components)
    def freeze_or_thaw(self, which: int) -> None:
        component = self.pick(which)
        component.is_frozen = not component.is_frozen

    @rule(which=which)
    @precondition(lambda self: self.cluster.components)
    def lose_messages(self, which: int) -> None:
        component = self.pick(which)
        component.down.clear()
        component.up.clear()

    @rule(which=which)
    @precondition(lambda self: self.cluster.components)
    def lose_one_message(self, which: int) -> None:
        component = self.pick(which)
        if component.down:
            component.down.popleft()

    @rule(which=st.integers(min_value=0, max_value=len(BLOBS) - 1))
    def forget_blob(self, which: int) -> None:
        self.cluster.carry_out(self.cluster.scheduler.forget(BLOBS[which].key))

    @rule(which=which)
    @precondition(lambda self: self.cluster.components)
    def repeat_message(self, which: int) -> None:
        component = self.pick(which)
        if component.up:
            component.up.appendleft(component.up[0])

    @rule(which=which)
    @precondition(lambda self: self.cluster.components)
    def drain(self, which: int) -> None:
        self.cluster.carry_out(self.cluster.scheduler.drain(self.pick(which).identity))

    @rule(which=which)
    @precondition(lambda self: self.cluster.components)
    def terminate(self, which: int) -> None:
        component = self.pick(which)
        component.carry_out(component.session.terminate("told to"))
        component.work.clear()

    @rule()
    def workers_gone(self) -> None:
        self.cluster.carry_out(self.cluster.scheduler.workers_gone("the launcher says so"))

    @invariant()
    def every_task_is_somewhere(self) -> None:
        cluster, scheduler = self.cluster, self.cluster.scheduler
        open_tasks = cluster.calls.keys() - cluster.ended.keys() - cluster.cancelled
        assert open_tasks == scheduler.tasks.keys()
        holders = Counter([*scheduler.dispatcher.queue, *scheduler.dispatcher.lost])
        for worker in scheduler.workers.values():
            holders.update(worker.backlog.keys())
            for open_batch in worker.batches.values():
                holders.update(n for n, task in open_batch.tasks.items() if not task.is_done)
        assert holders.keys() == open_tasks
        for number, count in holders.items():
            assert count == max(1, len(scheduler.tasks[number].holders)) <= 2
            assert count == 1 or self.policy.is_speculative

    @invariant()
    def windows_are_kept(self) -> None:
        for worker in self.cluster.scheduler.workers.values():
            assert len(worker.batches) <= CREDIT

    @invariant()
    def nobody_is_given_up_too_early(self) -> None:
        for number, outcome in self.cluster.ended.items():
            if isinstance(outcome, WorkerLostError):
                assert self.cluster.assigned[number] >= LOSS_BUDGET

    def teardown(self) -> None:
        self.cluster.settle()
        assert not self.cluster.scheduler.tasks, "tasks are stuck"
        self.every_task_is_somewhere()
        kinds = {type(outcome) for outcome in self.cluster.ended.values()}
        assert kinds <= {Result, WorkerLostError, NoWorkersError}


class ClusterWithABadMachine(RuleBasedStateMachine):
    """One machine loses whatever it is given, one always fails; good ones are always there."""

    policy: Policy = PullPolicy()
    which = st.integers(min_value=0, max_value=1000)

    def __init__(self) -> None:
        super().__init__()
        self.cluster = Cluster(self.policy)
        for name in ("bad-1", "good-1", "good-2"):
            self.start(name)

    def start(self, name: str) -> None:
        component = self.cluster.start_component(name)
        component.is_bad, component.is_sick = name.startswith("bad"), name.startswith("sick")
        self.cluster.pump(component, 10)

    @rule(count=st.integers(min_value=1, max_value=20))
    def submit(self, count: int) -> None:
        self.cluster.submit(count)

    @rule(which=which, count=st.integers(min_value=1, max_value=5))
    def work(self, which: int, count: int) -> None:
        component = self.cluster.components[which % len(self.cluster.components)]
        self.cluster.pump(component, 100)
        for _ in range(count):
            self.cluster.work(component)
        self.cluster.pump(component, 100)

    @rule()
    @precondition(lambda self: all(c.identity[:4] != b"sick" for c in self.cluster.components))
    def start_a_sick_one(self) -> None:
        self.start("sick")

    @rule(seconds=st.sampled_from([0.1, 1.0]))
    def pass_time(self, seconds: float) -> None:
        self.cluster.pass_time(seconds)
        for component in self.cluster.components:
            if component.identity.startswith(b"good"):  # silent for 15 s, it would not be there
                self.cluster.pump(component, 100)

    @rule(
        number=st.integers(min_value=-2, max_value=40),
        batch=st.integers(min_value=-1, max_value=3),
        has_value=st.booleans(),
    )
    @precondition(lambda self: self.cluster.scheduler.dispatcher.assignments.last)
    def lie(self, number: int, batch: int, has_value: bool) -> None:
        """Answer what nobody asked for, or with a wrong value."""
        name = f"liar-{self.cluster.started}"
        self.start(name)
        liar = self.cluster.components.pop()
        scheduler = self.cluster.scheduler
        own = scheduler.workers[liar.identity].batches
        held = min(own, default=scheduler.dispatcher.assignments.last) + batch
        numbers = [*own[held].tasks] if held in own and number < 0 else [abs(number)]
        header = b"a lie" if has_value else b""
        is_true = held in own and not has_value and set(numbers) <= own[held].tasks.keys()
        results = [Result(task, 0.001, header, []) for task in numbers]
        lie = Results(SESSION, max(0, held), results, False)
        self.cluster.hear_results(liar.identity, lie, lambda _: [])
        if not is_true:
            assert liar.identity not in scheduler.workers
            again = scheduler.register(b"again", liar.session._register, "key of " + name)
            assert [type(action) for action in again] == [Refuse]
        self.cluster.leave(liar)

    def teardown(self) -> None:
        cluster = self.cluster
        for _ in range(200):
            for component in list(cluster.components):
                cluster.work_off(component)
                if component.session.state is SessionState.STOPPED:  # the loader starts it again
                    cluster.components.remove(component)
                    self.start(component.session._register.worker)
            cluster.pass_time(1.0)
            if not cluster.scheduler.tasks:
                break
        assert not cluster.scheduler.tasks, "tasks are stuck"
        assert all(
            isinstance(outcome, Result) and not outcome.failure
            for outcome in cluster.ended.values()
        )
        assert all(name.startswith(("bad", "sick")) for name in cluster.scheduler._losses.retired)


class ClusterWithALiar(RuleBasedStateMachine):
    """Of four machines one gives wrong answers that look right, whenever it likes.

    It leaves whenever it likes too, and comes again under any name.

    Work begins anew where answers of a liar have been used, as `repeat_until_trusted` has it.
    """

    policy: Policy = AdaptivePolicy()
    which = st.integers(min_value=0, max_value=1000)

    @initialize(share=st.sampled_from([0.1, 0.5, 1.0]), seed=st.integers())
    def start(self, share: float, seed: int) -> None:
        self.verification = Verification(share, Random(seed).random)  # noqa: S311 - a test
        self.cluster = Cluster(self.policy, self.verification)
        self.liar = self.add("liar")
        for name in ("good-1", "good-2", "good-3"):
            self.add(name)
        self.has_lied = False
        self.begun = 0
        self.attempts = 1

    def add(self, name: str) -> Component:
        component = self.cluster.start_component(name)
        self.cluster.pump(component, 10)
        return component

    def pick(self, which: int) -> Component:
        return self.cluster.components[which % len(self.cluster.components)]

    @rule(count=st.integers(min_value=1, max_value=30))
    def submit(self, count: int) -> None:
        self.cluster.submit(count)

    @rule(lie=st.integers(min_value=0, max_value=3))
    def change_mind(self, lie: int) -> None:
        self.liar.lie = lie

    @rule(name=st.sampled_from(["liar", "another", "good-1"]), says_goodbye=st.booleans())
    def come_again(self, name: str, says_goodbye: bool) -> None:
        if says_goodbye:
            self.liar.carry_out(self.liar.session.terminate("for a while"))
            self.cluster.pump(self.liar, 100)
        self.cluster.kill(self.liar)
        lie, self.liar = self.liar.lie, self.cluster.start_component(name, "key of liar")
        self.liar.lie = lie
        self.cluster.pump(self.liar, 10)

    @rule(which=which, count=st.integers(min_value=1, max_value=10))
    def work(self, which: int, count: int) -> None:
        component = self.pick(which)
        self.cluster.pump(component, 100)
        for _ in range(count):
            self.has_lied |= bool(component.work and component.lie)
            self.cluster.work(component)
        self.cluster.pump(component, 100)

    @rule(which=which)
    def lose_one_message(self, which: int) -> None:
        component = self.pick(which)
        if component.down:
            component.down.popleft()

    @rule(which=which)
    def repeat_message(self, which: int) -> None:
        component = self.pick(which)
        if component.up:
            component.up.appendleft(component.up[0])

    @rule(seconds=st.sampled_from([0.1, 1.0]))
    def pass_time(self, seconds: float) -> None:
        self.cluster.pass_time(seconds)

    @rule()
    def begin_anew(self) -> None:
        if self.verification.distrust:
            self.cluster.carry_out(self.cluster.scheduler.start_over())
            self.begun = len(self.cluster.calls)
            self.attempts += 1

    @invariant()
    def nobody_is_accused_who_has_not_lied(self) -> None:
        assert not self.verification.liars or self.has_lied
        assert self.verification.liars.keys() <= {"liar"}

    @invariant()
    def nobody_honest_is_thrown_out(self) -> None:
        assert self.cluster.scheduler._losses.retired.keys() <= {"liar"}
        assert all(
            component.session.state is not SessionState.STOPPED
            for component in self.cluster.components
            if component is not self.liar
        )

    @invariant()
    def with_every_answer_verified_no_lie_is_used(self) -> None:
        if self.verification.share == 1.0:
            assert all(
                isinstance(outcome, DistrustError) or written_in(outcome) == number
                for number, outcome in self.cluster.ended.items()
            )

    def teardown(self) -> None:
        if not hasattr(self, "cluster"):
            return
        cluster = self.cluster
        self.begin_anew()
        cluster.submit(5)
        for _ in range(200):
            for component in list(cluster.components):
                cluster.pump(component, 1000)
                while component.work:
                    self.has_lied |= bool(component.lie)
                    cluster.work(component)
                cluster.pump(component, 1000)
            cluster.pass_time(1.0)
            if not cluster.scheduler.tasks:
                break
        assert not cluster.scheduler.tasks, "tasks are stuck"
        assert self.attempts <= 2, "there is one liar"
        ended = {n: end for n, end in cluster.ended.items() if n >= self.begun}
        if self.verification.distrust:
            return
        assert all(isinstance(outcome, Result) for outcome in ended.values())
        if self.verification.liars:  # then all that is left is the truth
            assert all(written_in(outcome) == number for number, outcome in ended.items())


class AdaptiveClusterWithABadMachine(ClusterWithABadMachine):
    """The same with tasks that are run a second time where a worker lags."""

    policy = AdaptivePolicy()


class EqualClusterWithABadMachine(ClusterWithABadMachine):
    """The same with the paper's policy."""

    policy = EqualPolicy()


class FaultyEqualCluster(FaultyCluster):
    """The same with the paper's policy."""

    policy = EqualPolicy()


class FaultyAdaptiveCluster(FaultyCluster):
    """The same with tasks that are run a second time where a worker lags."""

    policy = AdaptivePolicy()


class ManySchedules(AdaptiveClusterWithABadMachine):
    """Bad machines and liars under the default policy, over and over."""


class ManyLies(ClusterWithALiar):
    """A liar under every schedule, over and over."""


def play(machine: type[RuleBasedStateMachine], count: int = 60) -> type[TestCase]:
    """Return the test of a machine under so many schedules."""
    case: type[TestCase] = machine.TestCase
    case.settings = settings(  # type: ignore[attr-defined]
        max_examples=count,
        stateful_step_count=50,
        deadline=None,
        phases=[Phase.explicit, Phase.reuse, Phase.generate, Phase.shrink],
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
    )
    return case


TestManySchedules = pytest.mark.long(pytest.mark.timeout(1800)(play(ManySchedules, 1000)))
TestManyLies = pytest.mark.long(pytest.mark.timeout(1800)(play(ManyLies, 300)))
TestClusterWithALiar = play(ClusterWithALiar)
TestClusterWithABadMachine = play(ClusterWithABadMachine)
TestAdaptiveClusterWithABadMachine = play(AdaptiveClusterWithABadMachine)
TestEqualClusterWithABadMachine = play(EqualClusterWithABadMachine)
TestFaultyCluster = play(FaultyCluster)
TestFaultyEqualCluster = play(FaultyEqualCluster)
TestFaultyAdaptiveCluster = play(FaultyAdaptiveCluster)


@pytest.mark.parametrize("policy", POLICIES)
def test_without_faults_every_task_runs_exactly_once(policy: Policy) -> None:
    cluster = Cluster(policy)
    components = cluster.start_components(3)
    cluster.submit(300)
    while cluster.scheduler.tasks:
        for component in components:
            cluster.pump(component, 100)
            cluster.work(component)
    assert cluster.runs == Counter(range(300))
    assert cluster.scheduler.counts["dropped"] == 0


@pytest.mark.parametrize("policy", POLICIES)
def test_a_task_that_kills_its_workers_is_found_and_no_other_is_given_up(policy: Policy) -> None:
    cluster = Cluster(policy)
    components = cluster.start_components(2)
    cluster.submit(200)
    poison = 137
    for _ in range(2000):
        for component in components:
            cluster.pump(component, 100)
            if component.work and component.work[0][0].calls[component.work[0][1]].task == poison:
                cluster.crash_worker(component)
            else:
                cluster.work(component)
        if not cluster.scheduler.tasks:
            break
    given_up = {n for n, outcome in cluster.ended.items() if not isinstance(outcome, Result)}
    assert given_up == {poison}
    assert isinstance(cluster.ended[poison], WorkerLostError)


def test_a_batch_or_a_result_that_got_lost_is_made_good() -> None:
    for lose_the_batch in (True, False):
        cluster = Cluster(PullPolicy())
        [component] = cluster.start_components(1)
        cluster.submit(1)
        if lose_the_batch:
            component.down.clear()
        cluster.pump(component, 10)
        cluster.work(component)
        component.up.clear()
        for _ in range(5):
            cluster.pass_time(1.0)
            cluster.pump(component, 10)
            cluster.work(component)
        assert isinstance(cluster.ended[0], Result)
        assert cluster.scheduler.counts["resent"] == 1
        assert cluster.scheduler.counts["losses"] == 0


@pytest.mark.parametrize("policy", POLICIES)
def test_who_lost_a_task_is_not_waited_for_to_verify_it(policy: Policy) -> None:
    cluster = Cluster(policy, Verification(1.0))
    components = cluster.start_components(3)
    cluster.submit(1)
    steady: Component | None = None
    for _ in range(100):
        for component in components:
            cluster.pump(component, 100)
            if component.work and steady in (None, component):
                steady = component
                cluster.work(component)
            elif component.work:
                cluster.crash_worker(component)
    assert isinstance(cluster.ended[0], Result)


def test_tasks_of_two_kinds_that_wait_together_are_placed() -> None:
    cluster = Cluster(AdaptivePolicy())
    components = cluster.start_components(2)
    for number, name in enumerate(["a"] * 5 + ["b"] * 14):
        cluster.calls[number] = Call(number, name, b"", [])
        cluster.carry_out(cluster.scheduler.submit(Task(number, name, 10, limit_bytes=LIMIT)))
    cluster.carry_out(cluster.scheduler.dispatch())
    for _ in range(200):
        for component in components:
            cluster.pump(component, 100)
            cluster.work(component)
        cluster.pass_time(0.5)
    assert cluster.ended.keys() == set(range(19))


@pytest.mark.parametrize("key", ["key of worker-1", "unknown"])
def test_a_key_works_under_its_own_name_alone(key: str) -> None:
    cluster = Cluster(AdaptivePolicy())
    [first, second] = [cluster.start_component() for _ in range(2)]
    cluster.pump(first, 10)
    cluster.leave(first)
    actions = cluster.scheduler.register(second.identity, second.session._register, key)
    assert actions == [Refuse(second.identity, "its key is not that of 'worker-2'")]
