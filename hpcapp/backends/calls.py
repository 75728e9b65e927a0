"""What runs on a worker of a foreign engine, around each task: the same bits, or none."""

from __future__ import annotations

import platform
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

import numpy as np

from hpccomponent.errors import JobError
from hpccomponent.runtime.numerics import numerics_id

__all__ = ["align", "run_task"]

T = TypeVar("T")


def run_task(numerics: str, task: Callable[..., T], *arguments: Any) -> T:
    """Run a task, on a worker, if it computes the same bits as the master.

    Parameters
    ----------
    numerics : str
        The master's numerics id.
    task : callable
    *arguments
        Its values.

    Returns
    -------
    object
        What the task returns.

    Raises
    ------
    JobError
        This worker runs other kernels.
    """
    here = _numerics_here()
    if here != numerics:
        raise JobError(
            f"a worker on {platform.node()} computes with {here}, the master with {numerics}",
            "install the same build of hpcapp and numpy on all of them ('hpcapp --version')",
        )
    return task(*(align(value) for value in arguments))


@cache
def _numerics_here() -> str:
    """Return this process's numerics id; looking it up takes 20 ms."""
    return numerics_id()


def align(value: Any) -> Any:
    """Copy arrays that do not start at a multiple of their numbers' size.

    Parameters
    ----------
    value : object
        An array, or tuples, lists and dicts that may hold some.

    Returns
    -------
    object
        The value itself where nothing had to be copied, or an equal one.

    Notes
    -----
    Dask makes arrays of whatever place in a message they came in. numpy adds such numbers up
    through a buffer, in another order than aligned ones: the sum has other bits.

    Examples
    --------
    >>> odd = np.frombuffer(bytes(17), np.uint8)[1:].view(np.float64)
    >>> odd.flags.aligned, align([odd])[0].flags.aligned
    (False, True)
    """
    if isinstance(value, np.ndarray):
        return np.require(value, requirements="A")
    if type(value) in (tuple, list):
        return type(value)(align(item) for item in value)
    if isinstance(value, dict):
        return {key: align(item) for key, item in value.items()}
    return value
