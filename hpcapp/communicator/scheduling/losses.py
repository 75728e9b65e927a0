"""Which machine lost which tasks, where a lost one goes next, and which machines are retired.

A task that was lost goes to a machine that has not lost it, as long as there is one. What others
have done since is held against the machine that lost it, and nothing else is: a task that kills
its workers everywhere retires nobody.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import field

from hpcapp.communicator.scheduling.state import Task, Worker
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import NoWorkersError, WorkerLostError

LOSS_BUDGET = 3  # machines that may lose one task, or workers where there are fewer machines


@dataclass(slots=True)
class _Record:
    """What a machine has done and lost, or failed at alone.

    `done` and `spoilt` count by the name of the task: what it has finished, and what it lost and
    another one has done since. `is_shaken` until it has finished something after a loss.
    """

    memory_bytes: int
    lost: int = 0
    reason: str = ""
    is_shaken: bool = False
    done: Counter[str] = field(default_factory=Counter)
    spoilt: Counter[str] = field(default_factory=Counter)

    def is_bad(self) -> bool:
        """Tell whether it loses tasks that others can do, and no fewer than it does itself."""
        worse = sum(count for name, count in self.spoilt.items() if count >= self.done[name])
        return worse >= LOSS_BUDGET


class Losses:
    """The record of every machine, under the name that its worker registers with."""

    def __init__(self) -> None:
        self.retired: dict[str, str] = {}
        self._records: dict[str, _Record] = {}

    def blame(self, task: Task, worker: Worker, reason: str) -> None:
        """Hold the loss of a task against its machine, and against the task."""
        self.accuse(worker, reason)
        task.losses[worker.machine] += 1
        if task.is_done:  # it was run twice, and another one has done it
            self._record(worker).spoilt[task.name] += 1

    def is_bad(self, worker: Worker) -> bool:
        """Tell whether the machine of a worker is to be retired, and is not yet."""
        return worker.machine not in self.retired and self._record(worker).is_bad()

    def accuse(self, worker: Worker, reason: str) -> None:
        """Hold the loss of a worker against its machine."""
        record = self._record(worker)
        record.lost += 1
        record.reason, record.is_shaken = reason, True

    def credit(self, task: Task, worker: Worker) -> list[str]:
        """Note that a task is done, and return the machines that are bad by that."""
        record = self._record(worker)
        record.done[task.name] += 1
        record.is_shaken = False
        bad = []
        for machine in task.losses:
            other = self._records[machine]
            if machine != worker.machine and machine not in self.retired:
                other.spoilt[task.name] += 1
                if other.is_bad():
                    bad.append(machine)
        return bad

    def retire(self, machine: str, tasks: Iterable[Task]) -> str:
        """Have a machine get nothing more, take its losses off the tasks, and say why."""
        self.retired[machine] = self.describe([machine])
        for task in tasks:
            task.losses.pop(machine, None)
        return self.retired[machine]

    def find_candidates(self, task: Task, workers: Sequence[Worker]) -> list[Worker]:
        """Return the workers that may have a task that was lost: of the best kind that is there.

        First those on machines that have neither lost nor answered it, nor lost another one just
        now; then those on machines that have neither; then those that have not lost it; then all.
        Empty only where there are none.
        """
        without_loss = [worker for worker in workers if worker.machine not in task.losses]
        without_answer = [worker for worker in without_loss if worker.machine not in task.answers]
        steady = [worker for worker in without_answer if not self._record(worker).is_shaken]
        return steady or without_answer or without_loss or list(workers)

    def is_spent(self, task: Task, workers: Iterable[Worker]) -> bool:
        """Tell whether a task is to be given up, with these workers left."""
        if len(task.losses) >= LOSS_BUDGET:
            return True
        others = any(worker.machine not in task.losses for worker in workers)
        return not others and task.losses.total() >= LOSS_BUDGET

    def can_ask_another(self, task: Task, worker: Worker, workers: Iterable[Worker]) -> bool:
        """Tell whether another machine can say if it is the task that fails, or this machine."""
        if task.failed_on not in (None, worker.machine):
            return False
        machines = {worker.machine, *task.losses}
        return len(machines) < LOSS_BUDGET and any(
            other.machine not in machines for other in workers
        )

    def describe(self, machines: Iterable[str] | None = None) -> str:
        """Say in a line what these machines, or all, have lost, and why; empty for nothing."""
        clauses = []
        for machine in self._records if machines is None else machines:
            record = self._records[machine]
            if record.lost:
                times = "once" if record.lost == 1 else f"{record.lost} times, the last"
                size = _say_size(record.memory_bytes)
                clauses.append(f"{machine} failed {times} because {record.reason}; it has {size}")
        return "; ".join(clauses)

    def explain(self, task: Task) -> WorkerLostError:
        """Return the error of a task that is given up."""
        return WorkerLostError(
            f"task {task.name!r} lost {task.losses.total()} workers one after the other: "
            f"{self.describe(task.losses)}",
            "look for a crash or a lack of memory in what the task does with this batch",
        )

    def explain_absence(self, tasks: int, reason: str) -> NoWorkersError:
        """Return the error of so many tasks that nobody is left for."""
        lost = self.describe()
        return NoWorkersError(
            f"{tasks} tasks have no worker: {reason}{lost and f' ({lost})'}",
            "look at the log of the loaders and components, and start workers",
        )

    def _record(self, worker: Worker) -> _Record:
        memory_bytes = worker.register.memory_bytes
        return self._records.setdefault(worker.machine, _Record(memory_bytes))


def _say_size(size_bytes: int) -> str:
    mebibytes = size_bytes / 2**20
    return f"{mebibytes / 1024:.1f} GiB" if mebibytes >= 1024 else f"{mebibytes:.0f} MiB"
