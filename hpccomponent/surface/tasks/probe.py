"""How fast this machine is at the kernels, and how long the way to a worker takes (a task).

Who may import it: the master that chooses where a job runs.
"""

from __future__ import annotations

import os
import platform
from time import perf_counter

import numpy as np

from hpccomponent.runtime.tasks import declare
from hpccomponent.surface.fitting.pyramid import build_pyramid, fit_levels
from hpccomponent.surface.fitting.weights import weigh_levels
from hpccomponent.surface.tasks.result_patterns import PROBE, SMALL_BYTES
from hpccomponent.surface.types.points import ByteArray, PointCloud

__all__ = ["probe", "time_kernels"]

_POINTS = 400
_LEVELS = 3
_CELL = 0.15


def time_kernels(runs: int = 3) -> float:
    """Time a small fixed job: sorted points, their moments, and quadrics on three levels.

    Parameters
    ----------
    runs : int
        The best of so many counts: others may use the machine too.

    Returns
    -------
    float
        In seconds; some thousandths of one.
    """
    turn = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(_POINTS)
    z = (2.0 * np.arange(_POINTS) + 1.0) / _POINTS - 1.0  # a sphere, evenly covered
    across = np.sqrt(1.0 - z * z)
    sphere = np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)
    cloud, weights = PointCloud(sphere, sphere), weigh_levels(_CELL, _LEVELS, 0.0)
    origin = np.full(3, -1.0)
    best = np.inf
    for _ in range(runs):
        start = perf_counter()
        fit_levels(build_pyramid(cloud, origin, _CELL, _LEVELS), weights)
        best = min(best, perf_counter() - start)
    return float(best)


@declare(result=PROBE, limit=SMALL_BYTES)
def probe(payload: ByteArray, runs: int) -> tuple[str, float]:
    """Take some bytes, and time the kernels (a task).

    Parameters
    ----------
    payload : ndarray of uint8
        Whose way is timed by who sends it.
    runs : int
        See `time_kernels`; none where only the way counts.

    Returns
    -------
    worker : str
        The process that ran it.
    seconds : float
        0 without runs.
    """
    del payload
    return f"{platform.node()}/{os.getpid()}", time_kernels(runs) if runs else 0.0
