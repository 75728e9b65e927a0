"""What workers send as results, checked in one place before anything uses it.

::

    announced sizes ──> within the limits of the assignment? ──> frames ──> values ──> as declared?

Whatever does not pass is a `ProtocolError`: an honest worker has checked its own result, so that
this one is not to be trusted with anything.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from hpcapp.communicator.submission import Entry
from hpccomponent.errors import ProtocolError
from hpccomponent.protocol.codec import decode_values
from hpccomponent.protocol.declared import check_result
from hpccomponent.protocol.frames import Buffer, join_frames
from hpccomponent.protocol.messages import Result

__all__ = ["open_results"]


def open_results(
    results: Sequence[Result],
    limits: Sequence[int],
    largest_frame: int,
    take_frames: Callable[[int, int], Sequence[Buffer]],
    find: Callable[[int], Entry | None],
) -> list[Any]:
    """Return the values of results that came together.

    Parameters
    ----------
    results : sequence of Result
    limits : sequence of int
        How large each may be, in bytes; 0 where nobody waits for it: it is not looked at.
    largest_frame : int
        What both ends have agreed on, in bytes.
    take_frames : callable
        Receives the frames of these results, so many of them and so many bytes at most.
    find : callable
        From a task's number to its entry, if it still waits.

    Returns
    -------
    list
        A value for each; None where the task has failed, or nobody waits.

    Raises
    ------
    ProtocolError
        If one of them is not what its task declares, or larger than it may be.
    """
    if not any(limits):
        return [None] * len(results)
    for result, limit in zip(results, limits, strict=True):
        size = len(result.header) + sum(result.sizes)
        if size > limit:
            raise ProtocolError(f"it announces a result of {size} bytes where {limit} are allowed")
        if result.failure is not None and size:
            raise ProtocolError("it announces a result beside a failure")
    sizes = [size for result in results for size in result.sizes]
    frames = take_frames(sum([-(-size // largest_frame) for size in sizes]), sum(sizes))
    supply = iter(join_frames(frames, sizes))
    groups = [[next(supply) for _ in result.sizes] for result in results]
    return [
        _open(result, buffers, find(result.task))
        for result, buffers in zip(results, groups, strict=True)
    ]


def _open(result: Result, buffers: list[Buffer], entry: Entry | None) -> Any:
    if entry is None or result.failure is not None:
        return None
    try:
        values = decode_values(result.header, buffers)
        if len(values) != 1:
            raise ProtocolError(f"the result is {len(values)} values")
        check_result(entry.declared, values[0])
    except (ProtocolError, ValueError) as error:
        said = error.problem if isinstance(error, ProtocolError) else str(error)
        raise ProtocolError(f"its answer to {entry.name!r} is wrong: {said}") from error
    return values[0]
