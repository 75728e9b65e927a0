"""The communicator's open futures, with what has to be sent for them, until each is done."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Iterable

from hpcapp.communicator.scheduling.state import Task
from hpcapp.communicator.submission import Submission, split_submission
from hpcapp.timeline import note_worker
from hpccomponent import errors
from hpccomponent.errors import HpcError, TaskError
from hpccomponent.protocol.frames import Buffer
from hpccomponent.protocol.messages import Call, Failure, Result

_log = logging.getLogger(__name__)

_OF_MASTERS = (
    errors.CloudError,
    errors.DistrustError,
    errors.JobCancelledError,
    errors.NoWorkersError,
    errors.WorkerLostError,
)
"""What no task can find: a worker that says so would have the job begun anew, or believed."""


class PendingTasks:
    """Entries by task number; each leaves exactly once, with its future done.

    `number`, `add` and `cancel_all` are for any thread, the rest for that of the loop.
    """

    def __init__(self) -> None:
        self._submissions: dict[int, Submission] = {}
        self._numbers = itertools.count(1)

    def __len__(self) -> int:
        return len(self._submissions)

    def number(self) -> int:
        """Return a number that no task has."""
        return next(self._numbers)

    def add(self, number: int, submission: Submission) -> None:
        """Take a new submission."""
        self._submissions[number] = submission

    def cancel_all(self) -> None:
        """Cancel every future whose task has not left for a worker."""
        for submission in list(self._submissions.values()):
            submission.future.cancel()

    def calls(self, numbers: Iterable[int]) -> tuple[list[Call], list[Buffer]]:
        """Return what has to be sent for these tasks, and all their buffers in order."""
        calls: list[Call] = []
        buffers: list[Buffer] = []
        for number in numbers:
            submission = self._submissions[number]
            sizes = [len(buffer) for buffer in submission.buffers]
            keys = [blob.key for blob in submission.blobs]
            calls.append(
                Call(
                    number, submission.name, submission.header, sizes, keys, submission.limit_bytes
                )
            )
            buffers += submission.buffers
        return calls, buffers

    def find_changed(self, keys: Iterable[bytes]) -> list[int]:
        """Return the tasks that name one of these blobs, where its value has been changed."""
        sought_keys = set(keys)
        changed: dict[bytes, bool] = {}
        numbers = []
        for number, submission in self._submissions.items():
            for blob in submission.blobs:
                if blob.key in sought_keys and blob.key not in changed:
                    changed[blob.key] = not blob.is_unchanged()
                if changed.get(blob.key):
                    numbers.append(number)
                    break
        return numbers

    def claim(self, number: int) -> bool:
        """Mark a task as running; return False where its future was cancelled, and let it go."""
        if self._submissions[number].claim():
            return True
        del self._submissions[number]
        return False

    def split(self, number: int) -> list[Task]:
        """Replace a task by others that together do the same; none if it cannot be split."""
        submission = self._submissions[number]
        try:
            parts = split_submission(submission)
        except HpcError as error:
            _log.warning("%s", error)
            return []
        if not parts or not submission.claim():
            return []
        del self._submissions[number]
        tasks = []
        for part in parts:
            part_number = self.number()
            self._submissions[part_number] = part
            tasks.append(part.task(part_number))
        return tasks

    def is_cancelled(self, number: int) -> bool:
        """Tell whether a task is forgotten now because its future was cancelled in time."""
        return number in self._submissions and not self.claim(number)

    def find(self, number: int) -> Submission | None:
        """Return a submission that is still here."""
        return self._submissions.get(number)

    def deliver(
        self, number: int, result: Result, value: object, worker: str | None = None
    ) -> None:
        """Set a future's result, which has been checked, or what its task raised."""
        submission = self._submissions[number]
        if result.failure is not None:
            self.fail(number, _rebuild(result.failure, submission.name))
            return
        del self._submissions[number]
        note_worker(submission.future, worker)
        submission.future.set_result(value)

    def fail(self, number: int, error: HpcError) -> None:
        """Set a future's exception, unless it was cancelled in time."""
        submission = self._submissions.pop(number, None)  # at the end, two threads may come here
        if submission is not None and submission.claim():
            # One exception raised in two places would mix their tracebacks.
            copy = type(error)(error.problem, error.advice)
            for note in getattr(error, "__notes__", []):
                copy.add_note(note)
            submission.future.set_exception(copy)

    def fail_all(self, error: HpcError) -> None:
        """Set the exception of every future that is left."""
        for number in list(self._submissions):
            self.fail(number, error)


def _rebuild(failure: Failure, task: str) -> HpcError:
    """Make an error of what a task raised; one of our own tree keeps its class and exit code."""
    kind = getattr(errors, failure.kind) if failure.kind in errors.__all__ else None
    if kind is not None and not issubclass(kind, _OF_MASTERS):
        error: HpcError = kind(failure.problem, failure.advice)
    else:
        error = TaskError(f"task {task!r} failed: {failure.problem}", failure.advice)
    error.add_note(f"On the worker:\n{failure.traceback}")
    return error
