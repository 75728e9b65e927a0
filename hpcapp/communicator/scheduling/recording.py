"""What the scheduler's decisions were, in the timeline of the job: who had which task, and when."""

from __future__ import annotations

from collections.abc import Mapping

from hpcapp.communicator.scheduling.state import OpenBatch, Task, Worker
from hpcapp.timeline import Timeline, WorkerState
from hpccomponent.protocol.messages import Register, Result


class Recording:
    """Records tasks in a timeline, from the time on when there is one."""

    def __init__(self) -> None:
        self.timeline: Timeline | None = None

    def answered(
        self,
        worker: Worker,
        open_batch: OpenBatch,
        task: Task,
        result: Result,
        later_s: float,
    ) -> None:
        """Record an answer.

        The batch is empty if the worker has it no more; a task that is done was answered before.
        `later_s` is how long the tasks took, in seconds, whose answers came with it and after it.
        """
        if self.timeline is None:
            return
        outcome = "repeated" if task.is_done else "done" if result.failure is None else "failed"
        self.timeline.record(
            _function(task),
            worker.machine,
            result.seconds,
            outcome,
            ago=later_s,
            bytes_in=len(result.header) + sum(result.sizes),
            bytes_out=task.size_bytes + open_batch.take_shared(),
        )

    def taken_back(self, worker: Worker, open_batch: OpenBatch, at_work_s: float) -> None:
        """Record the tasks of a batch that its worker has not answered.

        The first has been at work for `at_work_s`; the others had not begun.
        """
        if self.timeline is None:
            return
        for task in open_batch.tasks.values():
            self.timeline.record(
                _function(task),
                worker.machine,
                at_work_s,
                "refused" if worker.is_refused else "lost",
                bytes_out=task.size_bytes + open_batch.take_shared(),
            )
            at_work_s = 0.0

    def turned_away(self, register: Register) -> None:
        """Record that a worker was not taken in."""
        if self.timeline is not None:
            self.timeline.record("register", register.worker, 0.0, "refused")


def list_workers(workers: Mapping[bytes, Worker]) -> list[WorkerState]:
    """Return what each worker does at the moment, for any thread to ask.

    The scheduler's own are copied in one step each, since they change meanwhile.
    """
    states = []
    for worker in list(workers.values()):
        open_batches = list(worker.batches.values())
        tasks = list(open_batches[0].tasks.values()) if open_batches else []
        state = "retired" if worker.is_retired else "leaving" if worker.is_draining else "busy"
        if state == "busy" and not tasks:
            state = "idle"
        states.append(WorkerState(worker.machine, state, _function(tasks[0]) if tasks else ""))
    return states


def _function(task: Task) -> str:
    """Return the name of a task's function, as other backends tell it."""
    return task.name.rpartition(".")[2]
