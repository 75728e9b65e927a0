"""Submitted tasks as the communicator keeps them, and how one becomes several."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any

from hpcapp.communicator.scheduling.state import Task
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import HpcError, TaskError, UsageError
from hpccomponent.protocol.blobs import Blob
from hpccomponent.protocol.codec import encode_arguments
from hpccomponent.protocol.declared import ANYTHING, Declared
from hpccomponent.protocol.frames import DEFAULT_RESULT_BYTES, Buffer
from hpccomponent.runtime.tasks import PLAIN, Traits, each_result

MAX_TASK_BLOBS = 256  # of one task: a component keeps a file open for each
ITEM_BYTES = 64  # of what stands around each value in a list, at most


@dataclass(slots=True, eq=False)
class Submission:
    """A submitted task: its future, its encoded arguments, and what it declares."""

    future: Future[Any]
    name: str
    header: bytes
    buffers: list[Buffer]
    blobs: tuple[Blob, ...] = ()
    work: float = 1.0
    arguments: tuple[object, ...] = ()
    traits: Traits = PLAIN
    declared: Declared = ANYTHING
    limit_bytes: int = DEFAULT_RESULT_BYTES
    is_claimed: bool = False

    @property
    def size_bytes(self) -> int:
        """Return the length of the encoded arguments."""
        return len(self.header) + (sum(map(len, self.buffers)) if self.buffers else 0)

    def task(self, number: int) -> Task:
        """Return what the scheduler knows of it, under a number."""
        return Task(
            number,
            self.name,
            self.size_bytes,
            self.blobs,
            self.work,
            self.traits.split is not None,
            self.limit_bytes,
            self.traits.is_verified,
        )

    def claim(self) -> bool:
        """Mark the future as running; False if it was cancelled before."""
        if not self.is_claimed and not self.future.set_running_or_notify_cancel():
            return False
        self.is_claimed = True
        return True


def make_submission(
    future: Future[Any], name: str, arguments: tuple[object, ...], traits: Traits
) -> Submission:
    """Encode a task; it keeps the arguments themselves only where it declares how it is split.

    Raise UsageError where an argument cannot travel, there are too many shared values, or the
    declared cost is no positive number.
    """
    header, buffers, blobs = encode_arguments(arguments)
    if len(blobs) > MAX_TASK_BLOBS:
        raise UsageError(
            f"a task names {len(blobs)} shared values, more than {MAX_TASK_BLOBS}",
            "share them together, as one tuple or dict",
        )
    work = 1.0
    if traits.cost is not None:
        work = float(traits.cost(*arguments))
        if not (0.0 < work < math.inf):
            raise UsageError(
                f"task {name!r} declares a cost of {work}", "let it return a number above 0"
            )
    split_arguments = arguments if traits.split is not None else ()
    declared, limit = traits.result_of(arguments), traits.limit_of(arguments)
    return Submission(
        future, name, header, buffers, blobs, work, split_arguments, traits, declared, limit
    )


def each_traits(traits: Traits) -> Traits:
    """Return what a task declares when it is run for each item of some columns of arguments.

    Its functions take columns: one list per argument, all of one length.
    """
    single = traits.cost

    def cost(*columns: list[object]) -> float:
        if single is None:
            return float(len(columns[0]))
        return sum(single(*item) for item in zip(*columns, strict=True))

    def split(*columns: list[object]) -> list[tuple[list[object], ...]] | None:
        half = len(columns[0]) // 2
        if not half:
            return None
        return [tuple(c[:half] for c in columns), tuple(c[half:] for c in columns)]

    def join(results: list[list[object]]) -> list[object]:
        return [value for part in results for value in part]

    def limit(*columns: list[object]) -> int:
        total = sum(traits.limit_of(item) for item in zip(*columns, strict=True))
        return min(DEFAULT_RESULT_BYTES, total + ITEM_BYTES * len(columns[0]))

    return Traits(cost, split, join, each_result(traits), limit, traits.is_verified)


def split_submission(submission: Submission) -> list[Submission]:
    """Cut a task into others whose results are joined to its own; none if it cannot be split.

    Its future is done with the last of the others, or by the first that fails. Raise HpcError where
    what the task declares for it fails.
    """
    split, join = submission.traits.split, submission.traits.join
    if split is None or join is None:
        return []
    try:
        pieces = split(*submission.arguments)
        if pieces is None or len(pieces) < 2:
            return []
        futures: list[Future[Any]] = [Future() for _ in pieces]
        submissions = [
            make_submission(future, submission.name, tuple(piece), submission.traits)
            for future, piece in zip(futures, pieces, strict=True)
        ]
    except HpcError:
        raise
    except Exception as error:
        raise TaskError(f"task {submission.name!r} could not be split: {error!r}") from error
    _join_into(submission, futures)
    return submissions


def _join_into(submission: Submission, futures: Sequence[Future[Any]]) -> None:
    """Have a future done by the last of others, or by the first that fails."""
    remaining = len(futures)

    def take(future: Future[Any]) -> None:
        nonlocal remaining
        remaining -= 1
        if submission.future.done():
            return
        error = future.exception()
        if error is not None:
            submission.future.set_exception(error)
        elif remaining == 0:
            try:
                join = submission.traits.join
                assert join is not None  # noqa: S101 - for mypy
                submission.future.set_result(join([future.result() for future in futures]))
            except Exception as error:
                submission.future.set_exception(
                    TaskError(
                        f"the parts of task {submission.name!r} could not be joined: {error!r}"
                    )
                )

    for future in futures:
        future.add_done_callback(take)
