"""Threads within a task: rows are cut into batches, and what a row gets depends on no batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from hpcapp.cancellation import JobThreads, check_cancelled

Batch = TypeVar("Batch")
Result = TypeVar("Result")


def run_batches(
    function: Callable[[Batch], Result], batches: Sequence[Batch], threads: int
) -> list[Result]:
    """Call `function` once per batch, `threads` at once, and return the results in order.

    The function releases Python's lock for most of its time, as the kernels do.
    """

    def run(batch: Batch) -> Result:
        check_cancelled()
        return function(batch)

    if threads <= 1 or len(batches) <= 1:
        return [run(batch) for batch in batches]
    with JobThreads(threads, "kernels") as pool:
        return list(pool.map(function, batches))
