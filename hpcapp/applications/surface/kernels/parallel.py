"""Threads within a task: rows are cut into batches, and what a row gets depends on no batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Batch = TypeVar("Batch")
Result = TypeVar("Result")


def run_batches(
    function: Callable[[Batch], Result], batches: Sequence[Batch], threads: int
) -> list[Result]:
    """Call `function` once per batch and return the results in order.

    Parameters
    ----------
    function : callable
        Releases Python's lock for most of its time, as the kernels do.
    threads : int
        How many calls run at once.
    """
    if threads <= 1 or len(batches) <= 1:
        return [function(batch) for batch in batches]
    with ThreadPoolExecutor(threads, thread_name_prefix="kernels") as pool:
        return list(pool.map(function, batches))
