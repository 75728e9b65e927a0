"""What the choice between this machine and workers stands on, measured: speeds, and the way.

Who may import it: what opens a job's backend.
"""

from __future__ import annotations

from concurrent.futures import wait
from time import perf_counter

import numpy as np

from hpcapp.applications.surface.backend_choice.cost_model import Here, Link, There
from hpcapp.workforce import Workforce

__all__ = ["measure_here", "measure_workers"]

_RUNS = 3
_FIRST_BYTES, _MOST_BYTES = 1 << 14, 1 << 24
_LONG_S = 0.005  # then the way of the bytes is told from the turn of a task


def measure_here(threads: int) -> Here:
    """Measure this machine, in some thousandths of a second.

    Parameters
    ----------
    threads : int
        That one process would use.
    """
    from hpccomponent.surface.tasks.probe import time_kernels  # heavy, and not for every job

    return Here(time_kernels(_RUNS), threads)


def measure_workers(workforce: Workforce, patience_s: float | None = None) -> There | None:
    """Measure workers and the way to them, in some hundredths of a second.

    Parameters
    ----------
    workforce : Workforce
        Whose Executor knows the task `probe`.
    patience_s : float, optional
        How long the first answers may take, which wait for the workers' imports.

    Returns
    -------
    There or None
        None if they took longer.

    Notes
    -----
    All workers are sent bytes at once, ever more until that takes a few thousandths of a second:
    what they share, as the master's own link, is measured as they share it.
    """
    nothing = np.empty(0, np.uint8)
    answers = _ask(workforce, nothing, _RUNS, patience_s)
    if answers is None:
        return None
    speeds = dict(answers[1])
    mean = sum(speeds.values()) / len(speeds)
    unit_s = [*speeds.values(), *[mean] * (workforce.workers - len(speeds))]
    latency_s = min(_time(workforce, nothing) for _ in range(2))
    size = _FIRST_BYTES
    while True:
        way_s = _time(workforce, np.zeros(size, np.uint8)) - latency_s
        if way_s >= _LONG_S or size >= _MOST_BYTES:
            break
        size *= 4
    bytes_per_s = workforce.workers * size / max(way_s, 1e-6)
    return There(tuple(unit_s), Link(latency_s, bytes_per_s))


def _ask(
    workforce: Workforce, payload: np.ndarray, runs: int, patience_s: float | None = None
) -> tuple[float, list[tuple[str, float]]] | None:
    """Have as many probes run as there are workers; return how long it took, and their answers."""
    from hpccomponent.surface.tasks.probe import probe

    start = perf_counter()
    futures = [workforce.executor.submit(probe, payload, runs) for _ in range(workforce.workers)]
    if wait(futures, patience_s).not_done:
        for future in futures:
            future.cancel()
        return None
    return perf_counter() - start, [future.result() for future in futures]


def _time(workforce: Workforce, payload: np.ndarray) -> float:
    answers = _ask(workforce, payload, 0)
    assert answers is not None  # noqa: S101 - it waits as long as it takes
    return answers[0]
