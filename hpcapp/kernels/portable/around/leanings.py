"""Values of nodes that are known at some, and follow over links elsewhere."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray, IntArray

__all__ = ["spread_leanings"]


def spread_leanings(
    first: IntArray,
    second: IntArray,
    strengths: FloatArray,
    sums: FloatArray,
    known: FloatArray,
    start: FloatArray,
    tolerance: float,
    most: int,
) -> FloatArray:
    """Solve the symmetric system of links by conjugate gradients, scaled by its diagonal.

    Links (l,) join the rows `first` and `second` of nodes, no two links the same two; `strengths`
    (l,) stand in the matrix, in both directions, without their sign. Its diagonal `sums` (n,) is
    above 0, `known` (n,) the right-hand side, `start` (n,) a first guess. `tolerance` is that of
    the residual, by the right-hand side, and `most` bounds the steps. Return values (n,).
    """
    count = len(sums)

    def multiply(values: FloatArray) -> FloatArray:
        linked = np.bincount(first, strengths * values[second], count)
        linked += np.bincount(second, strengths * values[first], count)
        product: FloatArray = sums * values - linked
        return product

    bound = tolerance**2 * float(known @ known)
    if bound == 0.0:
        return np.zeros(count)
    values = start.copy()
    residual = known - multiply(values)
    direction, last = np.zeros(count), 1.0
    for _ in range(most):
        if float(residual @ residual) < bound:
            break
        scaled = residual / sums
        fall = float(residual @ scaled)
        if not fall > 0.0:
            break
        direction = scaled + fall / last * direction
        product = multiply(direction)
        step = fall / float(direction @ product)
        values += step * direction
        residual -= step * product
        last = fall
    return values
