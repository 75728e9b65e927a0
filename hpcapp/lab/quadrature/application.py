"""Adaptive quadrature: the application of ``docs/how-to/write-an-application.md``.

It shares nothing with surface reconstruction but the framework: a task of values, and a master
process that cuts work into batches and decides what comes next.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hpcapp.workforce import Workforce, map_batches
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import JobError, UsageError
from hpccomponent.protocol.declared import Declared, Where
from hpccomponent.protocol.declared_arrays import Array
from hpccomponent.runtime.tasks import declare

FloatArray = NDArray[np.float64]

INTEGRANDS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "peak": lambda x: 1.0 / (1e-4 + (x - 0.5) ** 2),
    "root": lambda x: np.sqrt(np.abs(x)),
    "wave": lambda x: np.sin(50.0 * x) ** 2,
}
COARSE = np.polynomial.legendre.leggauss(7)
FINE = np.polynomial.legendre.leggauss(15)
MAX_ROUNDS = 60
MAX_INTERVALS = 1_000_000


@dataclass(frozen=True, slots=True)
class Integral:
    """An integral, the estimate of its absolute error, and how many intervals it took."""

    value: float
    error: float
    intervals: int


def estimated(integrand: str, left: FloatArray, right: FloatArray) -> Declared:
    """Return what `estimate` may return: no integral is larger than its box, or negative.

    NaN is what comes of ends beyond the range of numbers.
    """
    farthest = np.maximum(np.abs(left), np.abs(right))
    greatest = {"peak": np.full(len(left), 1e4), "root": np.sqrt(farthest)}
    most = 1.001 * (right - left) * greatest.get(integrand, np.ones(len(left)))

    def agrees(value: FloatArray) -> bool:
        return not bool(((value < 0.0) | (value > most[:, None])).any())

    pattern = Array("<f8", len(left), 2, finite=False)
    return Where(pattern, agrees, "integrals lie between 0 and width times height")


@declare(
    result=estimated,
    limit=lambda _integrand, left, _right: 4096 + 16 * len(left),
)
def estimate(integrand: str, left: FloatArray, right: FloatArray) -> FloatArray:
    """Integrate over each interval by Gauss-Legendre rules of 7 and 15 nodes.

    This is the task: importable, of values, deterministic, safe to run twice; the result of an
    interval does not depend on the others in its batch.

    Parameters
    ----------
    integrand : str
        A name in `INTEGRANDS`.
    left, right : ndarray of float64, shape (n,)
        Ends of the intervals.

    Returns
    -------
    ndarray of float64, shape (n, 2)
        The finer rule's value, and its distance from the coarser rule's.
    """
    function = INTEGRANDS[integrand]
    half, middle = 0.5 * (right - left), 0.5 * (right + left)
    sums = []
    for nodes, weights in (COARSE, FINE):
        total = np.zeros_like(half)
        for node, weight in zip(nodes, weights, strict=True):
            total += weight * function(middle + half * node)
        sums.append(half * total)
    return np.stack([sums[1], np.abs(sums[1] - sums[0])], axis=1)


def integrate(
    integrand: str, left: float, right: float, tolerance: float, workforce: Workforce
) -> Integral:
    """Integrate adaptively: halve the intervals whose error is too large, until none is.

    The integrand is named in `INTEGRANDS`; the tolerance is the largest absolute error to accept.

    Raises
    ------
    UsageError
        An unknown integrand, a range or a tolerance that is not finite and positive.
    JobError
        The tolerance is out of reach.

    Examples
    --------
    >>> from hpcapp.backends.serial import SerialExecutor
    >>> result = integrate("root", 0.0, 1.0, 1e-8, Workforce(SerialExecutor()))
    >>> abs(result.value - 2 / 3) < 1e-8
    True
    """
    if integrand not in INTEGRANDS:
        raise UsageError(f"no integrand {integrand!r}", f"choose one of {', '.join(INTEGRANDS)}")
    if not (np.isfinite([left, right]).all() and left < right and tolerance > 0):
        raise UsageError(
            f"cannot integrate from {left} to {right} within {tolerance}",
            "give finite ends, the smaller first, and a positive tolerance",
        )
    ends = np.linspace(left, right, 9)
    lefts, rights = ends[:-1], ends[1:]
    accepted = np.zeros(2)
    intervals = 0
    for _ in range(MAX_ROUNDS):
        if intervals + len(lefts) > MAX_INTERVALS:
            break
        batches = [(integrand, lefts[s], rights[s]) for s in workforce.cut(len(lefts))]
        estimates = np.concatenate(map_batches(workforce, estimate, batches))
        if not np.isfinite(estimates).all():
            raise JobError(f"{integrand} leaves the range of numbers there", "choose nearer ends")
        share = tolerance * (rights - lefts) / (right - left)
        split = estimates[:, 1] > share
        accepted += estimates[~split].sum(axis=0)
        intervals += int((~split).sum())
        if not split.any():
            return Integral(float(accepted[0]), float(accepted[1]), intervals)
        middles = 0.5 * (lefts[split] + rights[split])
        lefts = np.stack([lefts[split], middles], axis=1).ravel()
        rights = np.stack([middles, rights[split]], axis=1).ravel()
    raise JobError(
        f"{integrand} is not known to {tolerance} after {MAX_ROUNDS} halvings "
        f"or {MAX_INTERVALS} intervals",
        "ask for a larger tolerance or a shorter range",
    )
