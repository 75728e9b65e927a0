"""What the scheduler knows of tasks and workers, and the actions that it asks for."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Container
from dataclasses import field

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import HpcError
from hpccomponent.protocol.blobs import Blob
from hpccomponent.protocol.messages import Register, Result


@dataclass(slots=True, eq=False)
class Task:
    """A task that has no result yet.

    `work` is its declared cost, in units of its own, and `can_split` whether it declares how.
    `limit_bytes` is how large its result may be. `losses` counts, by machine, the workers that were
    lost while it was (or may have been) running, or on which it failed; `failed_on` is the machine
    whose failure is not believed until another one fails too; a task is claimed once, right before
    it first leaves. `holders` are the workers that hold it, with the batch: two where it is run
    again because the first is a straggler; the first answer counts, and then it is done. `answers`
    are the digests of those that wait for another machine to give the same, by machine (see
    `verification`); `has_written` tells whether one of these machines has written something that
    others may read.
    """

    number: int
    name: str
    size_bytes: int
    blobs: tuple[Blob, ...] = ()
    work: float = 1.0
    can_split: bool = False
    limit_bytes: int = 0
    is_verified: bool = True
    losses: Counter[str] = field(default_factory=Counter)
    failed_on: str | None = None
    is_claimed: bool = False
    is_done: bool = False
    holders: dict[bytes, int] = field(default_factory=dict)
    answers: dict[str, bytes] = field(default_factory=dict)
    has_written: bool = False

    def lacking_blobs(self, worker: Worker, added: Container[bytes] = ()) -> dict[bytes, Blob]:
        """Return by their keys its blobs that are neither known to be on `worker` nor `added`."""
        return {
            blob.key: blob
            for blob in self.blobs
            if not (blob.key in worker.blobs or blob.key in added)
        }

    @property
    def may_run_twice(self) -> bool:
        """Whether it can be run a second time while it runs."""
        # One that was lost with a worker may be what kills them: one at a time. One that is
        # verified must not go to who has answered it.
        return not (self.is_done or self.losses or self.answers or len(self.holders) > 1)


@dataclass(slots=True, eq=False)
class OpenBatch:
    """A batch on its way or at work: the tasks that its worker has not answered, in order.

    `work` is how much that is, by the names of these tasks, `counts` how many; `limits` how large
    the answer to each task of the whole batch may be, in bytes; `shared_bytes` what went before it.
    """

    tasks: dict[int, Task]
    work: dict[str, float] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    limits: dict[int, int] = field(default_factory=dict)
    shared_bytes: int = 0

    def __post_init__(self) -> None:
        self.counts.update(task.name for task in self.tasks.values())
        self.limits = {number: task.limit_bytes for number, task in self.tasks.items()}
        for task in self.tasks.values():
            self.work[task.name] = self.work.get(task.name, 0.0) + task.work

    def pop(self, number: int) -> Task | None:
        """Take a task out, if it is here."""
        task = self.tasks.pop(number, None)
        if task is not None:
            self.work[task.name] -= task.work
            self.counts[task.name] -= 1
            if not self.counts[task.name]:  # what rounding left of it is no work
                del self.work[task.name], self.counts[task.name]
        return task

    def take_shared(self) -> int:
        """Return the size of the blobs that went before the batch, in bytes, once; then 0."""
        shared, self.shared_bytes = self.shared_bytes, 0
        return shared


@dataclass(slots=True, eq=False)
class Worker:
    """A registered worker, under its identity on the socket.

    `batches` holds what is on its way or at work, in order, by the number of the batch; `since` is
    when its present task began, as far as is known. `remaining_s`, `next_s` and `slowness` are what
    a policy sees (see `policy.Load`). `backlog` holds what waits for this worker and no other.
    `blobs` are the keys of what has been sent to it; it may have let some go, and says so when one
    is needed. One that is retired gets nothing more, and waits for the end of the job; one that is
    refused is turned away.
    """

    identity: bytes
    register: Register
    key: str
    seen: float
    placed: int = 0
    progress: int = 0
    is_draining: bool = False
    is_retired: bool = False
    is_refused: bool = False
    since: float = 0.0
    remaining_s: float = 0.0
    next_s: float = 0.0
    slowness: float = 1.0
    batches: dict[int, OpenBatch] = field(default_factory=dict)
    backlog: OrderedDict[int, Task] = field(default_factory=OrderedDict)
    blobs: set[bytes] = field(default_factory=set)

    @property
    def machine(self) -> str:
        """Return the machine's name: there is one worker on each."""
        return self.register.worker

    @property
    def is_open(self) -> bool:
        """Tell whether it may get tasks."""
        return not (self.is_draining or self.is_retired)

    @property
    def queued(self) -> int:
        """Return how many batches the worker holds, at work or on their way."""
        return len(self.batches)


@dataclass(frozen=True, slots=True)
class Welcome:
    """Tell a worker that it is registered."""

    worker: bytes
    largest_frame: int


@dataclass(frozen=True, slots=True)
class Refuse:
    """Tell a worker that it is not wanted, and why."""

    worker: bytes
    reason: str


@dataclass(frozen=True, slots=True)
class AskRegister:
    """Tell an unknown sender to register again."""

    worker: bytes


@dataclass(frozen=True, slots=True)
class Dismiss:
    """Tell a worker to finish what it has, and leave."""

    worker: bytes


@dataclass(frozen=True, slots=True)
class Retire:
    """Say that a machine gets nothing more of this job, and why."""

    machine: str
    reason: str


@dataclass(frozen=True, slots=True)
class Assign:
    """Send a batch of tasks, by their numbers, after the blobs that the worker lacks."""

    worker: bytes
    batch: int
    tasks: tuple[int, ...]
    blobs: tuple[Blob, ...] = ()


@dataclass(frozen=True, slots=True)
class Forgotten:
    """Tell a worker that a blob will not be named again."""

    worker: bytes
    key: bytes


@dataclass(frozen=True, slots=True)
class Deliver:
    """Hand the first result of a task, at `index` of those that came together, to who waits."""

    task: int
    index: int
    result: Result


@dataclass(frozen=True, slots=True)
class Fail:
    """Give a task up."""

    task: int
    error: HpcError


Action = Welcome | Refuse | AskRegister | Dismiss | Retire | Assign | Forgotten | Deliver | Fail
