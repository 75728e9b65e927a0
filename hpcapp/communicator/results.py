"""What workers send as results, checked in one place before anything uses it.

::

    announced sizes ──> within the limits of the assignment? ──> buffers ──> values ──> as declared?

Whatever does not pass is a `ProtocolError`: an honest worker has checked its own result, so that
this one is not to be trusted with anything.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hpcapp.communicator.fetching import TakeBuffers
from hpcapp.communicator.scheduling.verification import digest_answer
from hpcapp.communicator.submission import Submission
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import ProtocolError
from hpccomponent.protocol.codec import decode_values
from hpccomponent.protocol.declared import check_result
from hpccomponent.protocol.frames import Buffer
from hpccomponent.protocol.messages import Result


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """A result that has been checked, with its value, and the buffers that it came in."""

    result: Result
    value: object = None
    buffers: Sequence[Buffer] = ()

    def digest(self) -> bytes:
        """Return what tells it from another answer; see `verification.digest_answer`."""
        return digest_answer(self.result, self.buffers)


def open_results(
    results: Sequence[Result],
    limits: Sequence[int],
    take_buffers: TakeBuffers,
    find: Callable[[int], Submission | None],
) -> list[Answer]:
    """Return the values of results that came together; None where a task failed or nobody waits.

    `limits` are how large each may be, in bytes; 0 where nobody waits for it: it is not looked at.
    `find` returns a submission by its task's number, if it still waits. Raise ProtocolError where a
    result is not what its task declares, or larger than it may be.
    """
    if not any(limits):
        return [Answer(result) for result in results]
    for result, limit in zip(results, limits, strict=True):
        _check_size(result, limit)
    supply = iter(take_buffers([size for result in results for size in result.sizes]))
    groups = [[next(supply) for _ in result.sizes] for result in results]
    return [
        Answer(result, _open(result, buffers, find(result.task)), buffers)
        for result, buffers in zip(results, groups, strict=True)
    ]


def _check_size(result: Result, limit: int) -> None:
    size = len(result.header) + sum(result.sizes)
    if size > limit:
        raise ProtocolError(f"it announces a result of {size} bytes where {limit} are allowed")
    if result.failure is not None and size:
        raise ProtocolError("it announces a result beside a failure")


def _open(result: Result, buffers: list[Buffer], submission: Submission | None) -> object:
    if submission is None or result.failure is not None:
        return None
    try:
        values = decode_values(result.header, buffers)
        if len(values) != 1:
            raise ProtocolError(f"the result is {len(values)} values")
        check_result(submission.declared, values[0])
    except (ProtocolError, ValueError) as error:
        problem = error.problem if isinstance(error, ProtocolError) else str(error)
        raise ProtocolError(f"its answer to {submission.name!r} is wrong: {problem}") from error
    return values[0]
