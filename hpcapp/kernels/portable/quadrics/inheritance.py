"""Priors: the mean of the parents' quadrics, expressed about their children."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.lattice import OCTANTS, corner_parents, find_keys, unpack_keys
from hpcapp.geometry.points import Float32Array, FloatArray, IntArray
from hpcapp.kernels.constants import BASIS

__all__ = ["inherit_level"]

_CHUNK_ROWS = 1 << 11


def inherit_level(
    vertices: IntArray,
    parents: IntArray,
    coefficients: Float32Array,
    values: Float32Array,
    threads: int = 1,
) -> tuple[Float32Array, Float32Array]:
    """Return the means of the parents' quadrics, about their children, and of other values.

    `vertices` (v,) are sorted keys of corners, `parents` (p,) those of corners of the next coarser
    level, all parents among them. Coefficients (p, 10) become (v, 10), and values (p, k), whatever
    else is to be averaged, (v, k).
    """
    del threads  # numpy runs on one
    # A corner on an odd place has two parents along an axis; on an even one the same twice: eight
    # of weight 1/8 whatever the place.
    means = np.zeros((len(vertices), BASIS))
    inherited = np.zeros((len(vertices), values.shape[1]))
    places = unpack_keys(vertices)
    for octant in OCTANTS:
        keys, steps = corner_parents(places, octant)
        rows = find_keys(parents, keys)
        means += 0.125 * inherit_quadrics(coefficients[rows].astype(np.float64), steps)
        inherited += 0.125 * values[rows]
    return means.astype(np.float32), inherited.astype(np.float32)


def inherit_quadrics(parents: FloatArray, steps: IntArray) -> FloatArray:
    """Express parents' quadrics (v, 10) about their children, in cells of half the size.

    f_child(u) = 2 f_parent((u + step) / 2), where the steps (v, 3) are child minus parent, in cells
    of the child.
    """
    children = np.empty_like(parents)
    for start in range(0, len(parents), _CHUNK_ROWS):
        rows = slice(start, start + _CHUNK_ROWS)
        columns = np.ascontiguousarray(parents[rows].T)
        shifts = np.ascontiguousarray(steps[rows].T.astype(np.float64))
        children[rows] = _inherit_columns(columns, shifts).T
    return children


def _inherit_columns(c: FloatArray, shifts: FloatArray) -> FloatArray:
    """Express quadrics (10, v) about places that are `shifts` (3, v) further on."""
    x, y, z = shifts
    child = np.empty_like(c)
    child[4:] = 0.5 * c[4:]  # second degree: (1/2)^2 of the argument, times 2
    child[1] = c[1] + c[4] * x + 0.5 * (c[7] * y + c[9] * z)
    child[2] = c[2] + c[5] * y + 0.5 * (c[7] * x + c[8] * z)
    child[3] = c[3] + c[6] * z + 0.5 * (c[8] * y + c[9] * x)
    # The value at the step: 2 f(step / 2).
    linear = c[1] * x + c[2] * y + c[3] * z
    square = c[4] * (x * x) + c[5] * (y * y) + c[6] * (z * z)
    mixed = c[7] * (x * y) + c[8] * (y * z) + c[9] * (z * x)
    child[0] = 2.0 * c[0] + linear + 0.5 * (square + mixed)
    return child
