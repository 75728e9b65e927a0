"""The poll that tells wrong normals."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.lattice import NEIGHBOURS, find_keys, step_keys
from hpcapp.geometry.points import ByteArray, Float32Array, FloatArray, IntArray
from hpcapp.kernels.constants import FINE, UNSURE, WRONG

__all__ = ["poll_normals"]

_ALIKE = 0.5  # cosine from which normals agree; below its negative they oppose


_LEAST, _MAJORITY = 8, 4  # opponents a verdict takes, and more for each that agrees


_CHUNK = 1 << 12


def poll_normals(
    positions: FloatArray,
    normals: FloatArray | Float32Array,
    keys: IntArray,
    cell_of: IntArray,
    asked: ByteArray,
    reach: float,
    tolerance: float,
    drift: float,
    threads: int = 1,
) -> ByteArray:
    """Ask the neighbours of each point what they think of its normal.

    Return `FINE`, `UNSURE` or `WRONG`, (n,); `FINE` for points (n, 3) whose `asked` (n,) is 0.
    `keys` (c,) are the occupied cells of edge `reach`, sorted, one at least; `cell_of` (n,) is the
    row of each point's cell. Neighbours lie within `reach`, and `tolerance` off a sheet at most;
    those that oppose a normal lie `drift` off it in their mean at most. These three are in length
    units of the input.
    """
    del threads  # numpy runs on one
    normals = normals.astype(np.float64, copy=False)
    # Cell i holds the points order[offsets[i]] to order[offsets[i + 1]].
    order = np.argsort(cell_of, kind="stable")
    offsets = np.searchsorted(cell_of[order], np.arange(len(keys) + 1))
    suspects = _find_suspects(normals, keys, cell_of, np.diff(offsets), asked)
    verdicts = np.full(len(positions), FINE, np.uint8)
    for start in range(0, len(suspects), _CHUNK):
        points = suspects[start : start + _CHUNK]
        # (3, m): who agrees, who opposes, and the sum of the latter's offsets.
        votes = np.zeros((3, len(points)))
        for step in NEIGHBOURS:
            cells = find_keys(keys, step_keys(keys[cell_of[points]], step))
            first = offsets[cells]
            counts = np.append(offsets, offsets[-1])[cells + 1] - first
            # (q,): each point that is asked about with each point of its neighbours' cell.
            asker = np.repeat(np.arange(len(points)), counts)
            rank = np.arange(len(asker)) - np.repeat(np.cumsum(counts) - counts, counts)
            others = order[np.repeat(first, counts) + rank]
            votes += _count_votes(positions, normals, (points, asker, others), reach, tolerance)
        verdicts[points] = _judge(votes, drift)
    return verdicts


def _find_suspects(
    normals: FloatArray, keys: IntArray, cell_of: IntArray, counts: IntArray, asked: ByteArray
) -> IntArray:
    """Return the points whose normals are at odds with the mean of their neighbourhood."""
    # (c + 1, 4): the sum of the normals in each cell, and their number; 0 of a cell without any.
    sums = np.zeros((len(keys) + 1, 4))
    for axis in range(3):
        sums[:-1, axis] = np.bincount(cell_of, normals[:, axis], len(keys))
    sums[:-1, 3] = counts
    around = np.zeros((len(keys), 4))
    for step in NEIGHBOURS:
        around += sums[find_keys(keys, step_keys(keys, step))]
    mean = around[cell_of]
    odd = _dot(normals, mean[:, :3]) <= _ALIKE * mean[:, 3]
    return np.flatnonzero(odd & (asked != 0))


def _judge(votes: FloatArray, drift: float) -> IntArray:
    """Return the verdicts on points, each with who agrees, who opposes and their offsets' sum."""
    agree, oppose = votes[0] - 1, votes[1]  # the point itself agrees
    unsure = (oppose > agree) | (agree + oppose < _LEAST)
    wrong = (oppose >= _LEAST + _MAJORITY * agree) & (np.abs(votes[2]) <= drift * oppose)
    return np.where(wrong, WRONG, np.where(unsure, UNSURE, FINE))


def _count_votes(
    positions: FloatArray,
    normals: FloatArray,
    pairs: tuple[IntArray, IntArray, IntArray],
    reach: float,
    tolerance: float,
) -> FloatArray:
    """Count for each point who on its sheet agrees and opposes; sum the latter's offsets."""
    points, asker, others = pairs
    asked = points[asker]
    # (q,): how far the neighbour is off the point's sheet; it counts where it lies on it, as seen
    # by either normal.
    away = positions[others] - positions[asked]
    offset = _dot(normals[asked], away)
    near = np.abs(offset) <= tolerance
    near &= _dot(away, away) <= reach * reach
    near &= np.abs(_dot(normals[others], away)) <= tolerance
    cosine = _dot(normals[asked], normals[others])
    oppose = near & (cosine < -_ALIKE)
    agree = np.bincount(asker[near & (cosine > _ALIKE)], minlength=len(points))
    opponents = np.bincount(asker[oppose], minlength=len(points))
    offsets = np.bincount(asker[oppose], offset[oppose], minlength=len(points))
    return np.stack([agree, opponents, offsets])


def _dot(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return row by row products, summed in the order of the axes as the native build does."""
    products = first * second
    total: FloatArray = products[:, 0] + products[:, 1] + products[:, 2]
    return total
