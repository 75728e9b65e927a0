"""What the scheduler's decisions were, in the timeline of the job: who had which task, and when."""

from __future__ import annotations

from hpcapp.communicator.state import Flight, Task, Worker
from hpcapp.timeline import Timeline
from hpccomponent.protocol.messages import Register, Result

__all__ = ["Recording"]


class Recording:
    """Records tasks in a timeline, from the time on when there is one.

    Attributes
    ----------
    timeline : Timeline or None
    """

    def __init__(self) -> None:
        self.timeline: Timeline | None = None

    def answered(
        self, worker: Worker, flight: Flight | None, task: Task, result: Result, later_s: float
    ) -> None:
        """Record an answer.

        Parameters
        ----------
        worker : Worker
            Who answers.
        flight : Flight or None
            The batch that the task is of, if the worker still has it.
        task : Task
            Which it answers; one that is done was answered before.
        result : Result
        later_s : float
            How long the tasks took, in seconds, whose answers came with it and after it.
        """
        if self.timeline is None:
            return
        outcome = "repeated" if task.is_done else "done" if result.failure is None else "failed"
        self.timeline.record(
            task.name,
            worker.machine,
            result.seconds,
            outcome,
            ago=later_s,
            bytes_in=len(result.header) + sum(result.sizes),
            bytes_out=task.size_bytes + (flight.take_shared() if flight is not None else 0),
        )

    def taken_back(self, worker: Worker, flight: Flight, at_work_s: float) -> None:
        """Record the tasks of a batch that its worker has not answered.

        Parameters
        ----------
        worker : Worker
            Who had it.
        flight : Flight
            What was left of it.
        at_work_s : float
            How long the first of them has been at work, in seconds; the others had not begun.
        """
        if self.timeline is None:
            return
        for task in flight.tasks.values():
            self.timeline.record(
                task.name,
                worker.machine,
                at_work_s,
                "refused" if worker.is_refused else "lost",
                bytes_out=task.size_bytes + flight.take_shared(),
            )
            at_work_s = 0.0

    def turned_away(self, register: Register) -> None:
        """Record that a worker was not taken in.

        Parameters
        ----------
        register : Register
            How it introduced itself.
        """
        if self.timeline is not None:
            self.timeline.record("register", register.worker, 0.0, "refused")
