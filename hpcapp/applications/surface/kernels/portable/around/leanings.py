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

    Parameters
    ----------
    first, second : ndarray of int64, shape (l,)
        The ends of each link, rows of nodes; no two links have the same two.
    strengths : ndarray of float64, shape (l,)
        What stands in the matrix for each link, in both directions, without its sign.
    sums : ndarray of float64, shape (n,)
        The diagonal of the matrix; above 0.
    known : ndarray of float64, shape (n,)
        The right-hand side.
    start : ndarray of float64, shape (n,)
        A first guess.
    tolerance : float
        Of the residual, by the right-hand side.
    most : int
        Steps.

    Returns
    -------
    ndarray of float64, shape (n,)
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
