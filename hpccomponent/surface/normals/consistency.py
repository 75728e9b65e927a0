"""Normals that point the wrong way, found by asking the neighbours on the same sheet.

Who may import it: `kernels`, and applications. `poll_normals` is a kernel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.cloud.outliers import NEIGHBOURS
from hpccomponent.surface.types.lattice import find_keys, step_keys
from hpccomponent.surface.types.points import FloatArray, IntArray, bounding_box

__all__ = [
    "FINE",
    "MARGIN",
    "UNSURE",
    "WRONG",
    "find_turned",
    "mend_normals",
    "poll_normals",
]

BoolArray = NDArray[np.bool_]
ByteArray = NDArray[np.uint8]
Float32Array = NDArray[np.float32]

FINE, UNSURE, WRONG = 0, 1, 2
"""What `poll_normals` finds of a normal."""

_EDGE = 3.0  # of the cells, in spacings: some 28 neighbours lie within
_TOLERANCE = 0.35  # spacings between a sheet and a point that still counts to it
_DRIFT = 0.5  # spacings between a sheet and the mean of those that oppose a normal on it
_ROUNDS = 3  # each with cells of twice the size, for what the last left open
_ALIKE = 0.5  # cosine from which normals agree; below its negative they oppose
_LEAST, _MAJORITY = 8, 4  # opponents a verdict takes, and more for each that agrees
_CHUNK = 1 << 12

MARGIN = _EDGE * (2.0**_ROUNDS - 1.0)
"""Spacings: as far as what decides over a normal lies, all rounds together."""


def mend_normals(
    positions: FloatArray, normals: FloatArray, spacing: float, threads: int = 1
) -> tuple[FloatArray, int]:
    """Turn round the normals that their neighbours on the same sheet contradict.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        In length units of the input.
    normals : ndarray of float64, shape (n, 3)
        Unit length.
    spacing : float
        Of the points, in length units of the input.
    threads : int
        The result does not depend on it.

    Returns
    -------
    normals : ndarray of float64, shape (n, 3)
        The input itself where nothing is wrong.
    flipped : int
        How many were turned round.

    Raises
    ------
    InputError, ValueError
        The cloud spans more than 2^20 spacings.

    Notes
    -----
    The neighbours of a point within 3 spacings count to its sheet where the offset between the
    two, along either normal, is at most 0.35 spacings: points of the other side of a thin plate
    do not. A normal is wrong where the neighbours that oppose it (n . m < -0.5) number eight, and
    four more for each that agrees. Where there are two sheets closer than that, both have their
    say and none has the majority. What remains open is asked again at twice and at four times
    the size, where the opponents' mean offset must stay below 0.5 spacings.
    """
    low, _ = bounding_box(positions)
    turned = find_turned(positions, normals, low, spacing, threads)
    flipped = int(np.count_nonzero(turned))
    return (np.where(turned[:, None], -normals, normals) if flipped else normals), flipped


def find_turned(
    positions: FloatArray,
    normals: FloatArray | Float32Array,
    low: FloatArray,
    spacing: float,
    threads: int = 1,
) -> BoolArray:
    """Find the normals that `mend_normals` turns round.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        Of a cloud, or of a region of it and all points within `MARGIN` spacings.
    normals : ndarray of float64 or float32, shape (n, 3)
        The result does not depend on how the same numbers are held.
    low : ndarray of float64, shape (3,)
        The least coordinates of the cloud.
    spacing : float
        Of the cloud, in length units of the input.
    threads : int
        The result does not depend on it.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    turned = np.zeros(len(positions), np.bool_)
    if len(positions) < _LEAST:
        return turned
    from hpccomponent.surface import kernels  # which knows this module

    asked = np.ones(len(positions), np.uint8)
    mended = normals
    # One side of a plate may hold ten times the other's points: opponents must lie on the sheet
    # in their mean, however wide the net is cast.
    drift = _DRIFT * spacing
    for number in range(_ROUNDS):
        scale = spacing * 2.0**number
        reach, tolerance = _EDGE * scale, _TOLERANCE * scale
        keys, _, cell_of = kernels.count_cells(positions, low, reach)
        verdicts = kernels.poll_normals(
            positions, mended, keys, cell_of, asked, reach, tolerance, drift, threads
        )
        wrong = verdicts == WRONG
        if wrong.any():
            turned ^= wrong
            mended = np.where(turned[:, None], -normals, normals)
        asked = (verdicts == UNSURE).astype(np.uint8)
        if not asked.any():
            break
    return turned


def poll_normals(
    positions: FloatArray,
    normals: FloatArray,
    keys: IntArray,
    cell_of: IntArray,
    asked: ByteArray,
    reach: float,
    tolerance: float,
    drift: float,
) -> ByteArray:
    """Ask the neighbours of each point what they think of its normal, in numpy (see `kernels`).

    Parameters
    ----------
    positions, normals : ndarray of float64, shape (n, 3)
    keys : ndarray of int64, shape (c,)
        Occupied cells of edge `reach`, sorted; at least one.
    cell_of : ndarray of int64, shape (n,)
        The row of each point's cell.
    asked : ndarray of uint8, shape (n,)
        Not 0 for the points to be judged.
    reach : float
        How far neighbours are, in length units of the input.
    tolerance : float
        How far off a sheet they may lie, in the same units.
    drift : float
        How far off it those that oppose a normal may lie in their mean.

    Returns
    -------
    ndarray of uint8, shape (n,)
        `FINE`, `UNSURE` or `WRONG`; `FINE` for points that are not asked.
    """
    order = np.argsort(cell_of, kind="stable")
    offsets = np.searchsorted(cell_of[order], np.arange(len(keys) + 1))
    suspects = _find_suspects(normals, keys, cell_of, np.diff(offsets), asked)
    verdicts = np.full(len(positions), FINE, np.uint8)
    for start in range(0, len(suspects), _CHUNK):
        points = suspects[start : start + _CHUNK]
        votes = np.zeros((3, len(points)))
        for step in NEIGHBOURS:
            cells = find_keys(keys, step_keys(keys[cell_of[points]], step))
            first = offsets[cells]
            counts = np.append(offsets, offsets[-1])[cells + 1] - first
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
    own = points[asker]
    away = positions[others] - positions[own]
    offset = _dot(normals[own], away)
    near = np.abs(offset) <= tolerance
    near &= _dot(away, away) <= reach * reach
    near &= np.abs(_dot(normals[others], away)) <= tolerance
    cosine = _dot(normals[own], normals[others])
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
