"""The scheduler as a state machine: events in, actions out, time injected; no socket, no thread.

::

    submit ──> queue ──policy──> backlog of a worker ──credit window──> batch in flight ──> result
                 ^                      │                                  │
                 └──────────────────────┴──────── the worker is lost ──────┘

Promises: every submitted task ends exactly once, by a result, an error, or its cancellation; a
result that comes twice is dropped, and counted where the task was run twice on purpose; a task that
was lost runs on another machine, as long as there is one, and is given up after too many of them;
so is everything when no worker is left and none is to be expected. What fails on one machine, once
or again, is asked of another one before it is believed. A machine that loses, or fails at, what
others can do is retired, as long as there are others; a worker that lies is turned away.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

from hpcapp.communicator.scheduling.admission import Admission
from hpcapp.communicator.scheduling.dispatching import Dispatcher
from hpcapp.communicator.scheduling.losses import Losses
from hpcapp.communicator.scheduling.policy import Policy
from hpcapp.communicator.scheduling.recording import Recording
from hpcapp.communicator.scheduling.state import (
    Action,
    AskRegister,
    Deliver,
    Dismiss,
    Fail,
    Forgotten,
    OpenBatch,
    Refuse,
    Retire,
    Task,
    Welcome,
    Worker,
)
from hpcapp.communicator.scheduling.verification import AnswerVerdict, Verification, explain_dispute
from hpccomponent.clock import Clock
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import DistrustError, HpcError
from hpccomponent.protocol.frames import LARGEST_FRAME
from hpccomponent.protocol.messages import Failure, Register, Result


@dataclass(frozen=True, slots=True, eq=False)
class _Answer:
    """What a worker says of a task; `index` is its place among the results that came together."""

    task: Task
    worker: Worker
    result: Result
    index: int
    digest: Callable[[], bytes]


class Scheduler:
    """Decides who gets which task, and what becomes of tasks whose worker is lost.

    `claim` and `split` are those of `Dispatcher`. Components must have the release `package`, the
    numerics id, by default that of the first one, and a key in `names`; by default they are not
    looked at. Without a verification nothing is asked for again. In seconds, a worker that has been
    silent for `liveness_s` is lost, and tasks wait for `worker_wait_s` when there is none.
    """

    def __init__(
        self,
        policy: Policy,
        clock: Clock,
        package: str,
        claim: Callable[[int], bool],
        numerics: str | None = None,
        liveness_s: float = 15.0,
        worker_wait_s: float = 60.0,
        split: Callable[[int], list[Task]] = lambda _: [],
        verification: Verification | None = None,
        names: Mapping[str, str] | None = None,
    ) -> None:
        self.verification = verification or Verification()
        self.verification.begin()
        self.workers: dict[bytes, Worker] = {}
        self.tasks: dict[int, Task] = {}
        self.counts: Counter[str] = Counter()
        self.recording = Recording()
        self._clock = clock
        self._admission = Admission(package, numerics, self.verification.liars, names)
        self._claim = claim
        self._split = split
        self._liveness_s = liveness_s
        self._worker_wait_s = worker_wait_s
        self._losses = Losses()
        self.dispatcher = Dispatcher(
            policy, clock, self._losses, self._claim_task, self._split_task
        )
        self._alone_since: float | None = None
        self._gone: str | None = None

    # -- events of the App ---------------------------------------------------------------------

    def submit(self, task: Task) -> list[Action]:
        """Take a new task; call `dispatch` after the last of several."""
        self.tasks[task.number] = task
        if self.verification.distrust:
            return self._distrust()
        if self._gone is not None and self._is_alone():
            return self._give_up(self._gone)
        self.dispatcher.queue[task.number] = task
        if self._is_alone() and self._alone_since is None:
            self._alone_since = self._clock.now()
        return []

    def cancel(self, number: int) -> list[Action]:
        """Forget a task that has not left; one that has left runs on, its result is dropped."""
        task = self.tasks.pop(number, None)
        if task is not None:
            self._withdraw(task)
        return self.dispatch()

    def forget(self, key: bytes) -> list[Action]:
        """Take the news that nobody can name a blob any more."""
        actions: list[Action] = []
        for worker in self.workers.values():
            if key in worker.blobs:
                worker.blobs.remove(key)
                actions.append(Forgotten(worker.identity, key))
        return actions

    def workers_gone(self, reason: str) -> list[Action]:
        """Take the launcher's word that no worker will come; tasks fail once none is left."""
        self._gone = reason
        return self._give_up(reason) if self._is_alone() else []

    def start_over(self) -> list[Action]:
        """Begin anew after a `DistrustError`: what comes from now on is of another attempt."""
        self.verification.begin()
        return []

    def drain(self, identity: bytes) -> list[Action]:
        """Let a worker finish what it has and leave; what it has not been sent goes elsewhere."""
        worker = self.workers.get(identity)
        if worker is None:
            return []
        worker.is_draining = True
        self.dispatcher.requeue(worker.backlog.values())
        worker.backlog.clear()
        return [Dismiss(identity), *self.dispatch()]

    def expel(self, key: str) -> list[Action]:
        """Turn away the workers of a revoked key; what they had goes elsewhere, without blame."""
        revoked = [worker for worker in self.workers.values() if worker.key == key]
        return self._turn_away(revoked, "its key was revoked") + self.dispatch()

    # -- events of the workers -----------------------------------------------------------------

    def register(self, identity: bytes, register: Register, key: str = "") -> list[Action]:
        """Take a worker in, or say why not; a new incarnation of a worker replaces the old."""
        reason = self._admission.objection(register, key, self.workers.values())
        if reason is not None:
            self.counts["refused"] += 1
            self.recording.turned_away(register)
            return [Refuse(identity, reason)]
        self._admission.numerics = register.numerics
        level = min((worker.placed for worker in self._open_workers()), default=0)
        worker = Worker(identity, register, key, self._clock.now(), placed=level)
        worker.is_retired = worker.machine in self._losses.retired
        # A repeated registration changes nothing: what got lost shows in the next heartbeat.
        self.workers.setdefault(identity, worker).seen = worker.seen
        if not worker.is_retired:
            self._alone_since = None
        actions: list[Action] = []
        for other in list(self.workers.values()):
            if other.identity != identity and other.register.worker == register.worker:
                actions += self._lose(other, "it was started anew", is_blamed=True)
        largest = min(LARGEST_FRAME, register.largest_frame)
        return [*actions, Welcome(identity, largest), *self.dispatch()]

    def results(
        self,
        identity: bytes,
        batch: int,
        results: Sequence[Result],
        is_finished: bool,
        digest: Callable[[int], bytes],
    ) -> list[Action]:
        """Take results of tasks that it was given; `digest` tells one from another answer."""
        worker = self.workers.get(identity)
        if worker is None:
            return self._stranger(identity)
        worker.seen = self._clock.now()
        actions: list[Action] = []
        liars: dict[str, str] = {}
        open_batch = worker.batches.get(batch, OpenBatch({}))
        later_s = sum([result.seconds for result in results])
        transit_s = max(0.0, worker.seen - worker.since - later_s) / max(1, len(results))
        for index, result in enumerate(results):
            later_s -= result.seconds
            batch_task = open_batch.pop(result.task)
            task = self.tasks.get(result.task)
            if answered := task or batch_task:
                self.recording.answered(worker, open_batch, answered, result, later_s)
            if batch_task is not None and result.failure is None:
                self.dispatcher.forecast.learn(identity, batch_task, result.seconds, transit_s)
            if task is None:
                self.counts["dropped" if batch_task is None else "duplicates"] += 1
            elif batch_task is None and result.failure is not None:
                self.counts["dropped"] += 1  # it comes twice or late: the task was placed anew
            else:
                answer = _Answer(task, worker, result, index, partial(digest, index))
                actions += self._take(answer, liars)
        worker.since = worker.seen
        if is_finished:
            actions += self._take_back(worker, batch, "it left out a result", is_blamed=True)
        for machine, reason in liars.items():
            actions += self._turn_liar_away(machine, reason)
        return actions + self.dispatch()

    def expose(self, identity: bytes, reason: str) -> list[Action]:
        """Turn a liar away; its tasks go elsewhere, without blame: a lie is never their fault."""
        liar = self.workers.get(identity)
        if liar is None:
            return []
        self._losses.accuse(liar, reason)
        return self._turn_liar_away(liar.machine, reason) + self.dispatch()

    def heartbeat(
        self, identity: bytes, progress: int, last_batch: int, held: Iterable[int]
    ) -> list[Action]:
        """Take a sign of life, which acknowledges batches too.

        Messages keep their order, so that of the batches up to `last_batch` (named by the last
        ping that got through) those are lost that the worker neither holds nor has answered.
        """
        worker = self.workers.get(identity)
        if worker is None:
            return self._stranger(identity)
        worker.seen = self._clock.now()
        worker.progress = progress
        lost = {batch for batch in worker.batches if batch <= last_batch}.difference(held)
        actions: list[Action] = []
        for batch in sorted(lost):
            self.counts["resent"] += 1
            actions += self._take_back(worker, batch, "a message got lost", is_blamed=False)
        return actions + self.dispatch() if lost else actions

    def batch_lost(self, identity: bytes, batch: int, reason: str, is_blamed: bool) -> list[Action]:
        """Take the news that a worker process died; `is_blamed` on this batch, or a bystander."""
        worker = self.workers.get(identity)
        if worker is None:
            return self._stranger(identity)
        worker.seen = self._clock.now()
        self.counts["losses"] += is_blamed
        return self._take_back(worker, batch, reason, is_blamed) + self.dispatch()

    def need(self, identity: bytes, batch: int, keys: Iterable[bytes]) -> list[Action]:
        """Take a batch back whose blobs the worker has not got, or has let go meanwhile."""
        worker = self.workers.get(identity)
        if worker is None:
            return self._stranger(identity)
        worker.seen = self._clock.now()
        worker.blobs.difference_update(keys)
        self.counts["needed"] += 1
        actions = self._take_back(worker, batch, "a blob is missing", is_blamed=False)
        return actions + self.dispatch()

    def goodbye(self, identity: bytes, reason: str) -> list[Action]:
        """Take leave of a worker that was preempted or drained: nothing is held against tasks."""
        worker = self.workers.get(identity)
        if worker is None:
            return []
        return self._lose(worker, reason, is_blamed=False) + self.dispatch()

    def disconnected(self, identities: Iterable[bytes], reason: str) -> list[Action]:
        """Take the news that the way to workers is broken: they are lost.

        All of them before anything is placed anew: what one of them leaves must not be handed to
        another, and be blamed for its loss too.
        """
        actions: list[Action] = []
        for identity in identities:
            if identity in self.workers:
                actions += self._lose(self.workers[identity], reason, is_blamed=True)
        return actions + self.dispatch()

    def undelivered(self, identity: bytes, batch: int, reason: str) -> list[Action]:
        """Take the news that a batch did not get out to its worker, which is lost."""
        worker = self.workers.get(identity)
        if worker is None:
            return []
        actions = self._take_back(worker, batch, reason, is_blamed=False)
        return actions + self.disconnected([identity], reason)

    def tick(self) -> list[Action]:
        """Take the time: silent workers are lost, and waiting for workers has an end."""
        now = self._clock.now()
        actions: list[Action] = []
        silence = f"it has been silent for {self._liveness_s:g} s"
        for worker in list(self.workers.values()):
            if now - worker.seen > self._liveness_s:
                actions += self._lose(worker, silence, is_blamed=True)
        alone_s = 0.0 if self._alone_since is None else now - self._alone_since
        if alone_s > self._worker_wait_s:
            actions += self._give_up(f"none came within {self._worker_wait_s:g} s")
        return actions + self.dispatch()

    def dispatch(self) -> list[Action]:
        """Place what waits, and send what the credit windows allow."""
        return [*self.dispatcher.dispatch(self.workers.values())]

    def _claim_task(self, number: int) -> bool:
        is_wanted = self._claim(number)
        if not is_wanted:
            del self.tasks[number]
        return is_wanted

    def _split_task(self, number: int) -> list[Task]:
        parts = self._split(number)
        if parts:
            self.counts["splits"] += 1
            del self.tasks[number]
            self.tasks.update({part.number: part for part in parts})
        return parts

    def _open_workers(self) -> list[Worker]:
        return [worker for worker in self.workers.values() if worker.is_open]

    def _is_alone(self) -> bool:
        return all(worker.is_retired for worker in self.workers.values())

    # -- lying and losing ---------------------------------------------------------------------

    def _take(self, answer: _Answer, liars: dict[str, str]) -> list[Action]:
        """Deliver an answer, unless another machine is to be asked before."""
        task, worker, failure = answer.task, answer.worker, answer.result.failure
        if failure is not None:
            if self._losses.can_ask_another(task, worker, self._open_workers()):
                return self._ask_another(task, worker, failure)
        elif (consequences := self._judge(answer, liars)) is not None:
            return consequences
        del self.tasks[task.number]
        self._withdraw(task)
        actions: list[Action] = [Deliver(task.number, answer.index, answer.result)]
        if failure is None:
            for machine in self._losses.credit(task, worker):
                actions += self._retire(machine)
        return actions

    def _judge(self, answer: _Answer, liars: dict[str, str]) -> list[Action] | None:
        """Judge an answer; None where it is believed, else what is to be done about it."""
        task, worker, result = answer.task, answer.worker, answer.result
        machine = worker.machine
        others = {w.machine for w in self._open_workers()} - {machine, *task.answers, *task.losses}
        task.has_written |= bool(result.written)
        self.verification.seconds += result.seconds if task.answers else 0.0
        verdict, lying = self.verification.judge(task, machine, others, answer.digest)
        if lying and result.written:  # what a liar has written may be what others read
            self.verification.note_written(lying)
        liars |= dict.fromkeys(lying, f"its answer to {task.name!r} is not that of the others")
        if verdict is AnswerVerdict.BELIEVED:
            return None
        task.holders.pop(worker.identity, None)
        if verdict is AnswerVerdict.UNDECIDED:
            self._withdraw(self.tasks.pop(task.number))
            return [Fail(task.number, explain_dispute(task))]
        if not task.holders:
            self.dispatcher.requeue([task])
        return []

    def _turn_liar_away(self, machine: str, reason: str) -> list[Action]:
        """Ban a machine, and with it what its answers led to."""
        self.counts["lies"] += 1
        why = f"{machine} works for this job no more: {reason}"
        self.verification.accuse(machine, why, self.tasks.values())
        same = [worker for worker in self.workers.values() if worker.machine == machine]
        return self._turn_away(same, why) + (self._distrust() if self.verification.distrust else [])

    def _distrust(self) -> list[Action]:
        """Give up all tasks, because answers that have been used may be lies."""
        return self._fail_all(DistrustError(self.verification.distrust, "begin the work anew"))

    def _fail_all(self, error: HpcError) -> list[Action]:
        actions: list[Action] = [Fail(number, error) for number in self.tasks]
        for task in self.tasks.values():
            self._withdraw(task)
        self.tasks.clear()
        return actions

    def _lose(self, worker: Worker, reason: str, is_blamed: bool) -> list[Action]:
        del self.workers[worker.identity]
        self.dispatcher.forecast.forget(worker.identity)
        self.counts["losses"] += is_blamed
        self.dispatcher.requeue(worker.backlog.values())
        actions: list[Action] = []
        # Batches run in order, so that only the first can have been at work.
        for index, batch in enumerate(list(worker.batches)):
            actions += self._take_back(worker, batch, reason, is_blamed and index == 0)
        if self._is_alone():
            if self._gone is not None:
                return actions + self._give_up(self._gone)
            if self._alone_since is None and self.tasks:
                self._alone_since = self._clock.now()
        return actions

    def _turn_away(self, workers: Iterable[Worker], why: str) -> list[Action]:
        actions: list[Action] = []
        for worker in workers:
            worker.is_refused = True
            actions.append(Refuse(worker.identity, why))
            actions += self._lose(worker, why, is_blamed=False)
        return actions

    def _retire(self, machine: str) -> list[Action]:
        """Give a machine nothing more, and take back what it has; the last one is kept."""
        if not any(worker.machine != machine for worker in self._open_workers()):
            return []
        actions: list[Action] = [Retire(machine, self._losses.retire(machine, self.tasks.values()))]
        for worker in [worker for worker in self.workers.values() if worker.machine == machine]:
            worker.is_retired = True
            self.dispatcher.requeue(worker.backlog.values())
            worker.backlog.clear()
            for batch in list(worker.batches):
                actions += self._take_back(worker, batch, "it is retired", is_blamed=False)
        return actions

    def _take_back(self, worker: Worker, batch: int, reason: str, is_blamed: bool) -> list[Action]:
        """Put the tasks of a batch back into the queue, but for those at work elsewhere too."""
        actions: list[Action] = []
        again = []
        at_work_s = 0.0
        if next(iter(worker.batches), None) == batch:
            at_work_s, worker.since = self._clock.now() - worker.since, self._clock.now()
        open_batch = worker.batches.pop(batch, OpenBatch({}))
        self.recording.taken_back(worker, open_batch, at_work_s)
        self.dispatcher.assignments.take_back(batch, open_batch)
        for task in open_batch.tasks.values():
            task.holders.pop(worker.identity, None)
            if is_blamed:
                self._losses.blame(task, worker, reason)
            if task.is_done or task.holders:
                continue
            if not task.losses or not self._losses.is_spent(task, self._open_workers()):
                again.append(task)
                continue
            del self.tasks[task.number]
            actions.append(Fail(task.number, self._losses.explain(task)))
        self.dispatcher.requeue(again)
        if is_blamed and self._losses.is_bad(worker):
            actions += self._retire(worker.machine)
        return actions

    def _ask_another(self, task: Task, worker: Worker, failure: Failure) -> list[Action]:
        """Hold a failure against the machine, until another one has failed as well."""
        self.counts["doubted"] += 1
        task.failed_on = worker.machine
        task.holders.pop(worker.identity, None)
        self._losses.blame(task, worker, f"{task.name!r} failed there ({failure.problem})")
        if not task.holders:
            self.dispatcher.requeue([task])
        return self._retire(worker.machine) if self._losses.is_bad(worker) else []

    def _withdraw(self, task: Task) -> None:
        """Take a task that is over from wherever it waits; where it runs, its answer is late."""
        task.is_done = True
        self.dispatcher.withdraw(task.number)
        for identity in task.holders:
            worker = self.workers.get(identity)
            if worker is not None:
                worker.backlog.pop(task.number, None)

    def _give_up(self, reason: str) -> list[Action]:
        self._alone_since = None
        return self._fail_all(self._losses.explain_absence(len(self.tasks), reason))

    def _stranger(self, identity: bytes) -> list[Action]:
        self.counts["dropped"] += 1
        return [AskRegister(identity)]
