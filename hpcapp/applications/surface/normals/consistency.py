"""Normals that point the wrong way, found by asking the neighbours on the same sheet."""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface import kernels
from hpcapp.applications.surface.kernels import UNSURE, WRONG, bound_points
from hpcapp.applications.surface.types.lattice import (
    cells_of,
    find_first,
    lay_lattice,
    number_keys,
    pack_places,
)
from hpcapp.applications.surface.types.points import BoolArray, Float32Array, FloatArray, PointCloud

__all__ = ["MARGIN", "faces_inwards", "find_turned", "share_opposed"]


_EDGE = 3.0  # of the cells, in spacings: some 28 neighbours lie within
_TOLERANCE = 0.35  # spacings between a sheet and a point that still counts to it
_DRIFT = 0.5  # spacings between a sheet and the mean of those that oppose a normal on it
_FEW = 8  # points, of which none is told
_PAIRS = 8  # of each point, with those after it in its box
_ROUNDS = 3  # each with cells of twice the size, for what the last left open
_SAMPLE = 10_000  # points by which it is judged where normals face
_FEWEST_JUDGED = 100  # of which it is judged
_BOXES = 24  # along the longest side, whose mean normals count
_INWARD = -0.1  # mean of n.(x - c) / |x - c|; a sphere seen from outside has 1, from inside -1

MARGIN = _EDGE * (2.0**_ROUNDS - 1.0)
"""Spacings: as far as what decides over a normal lies, all rounds together."""


def find_turned(
    positions: FloatArray, normals: FloatArray | Float32Array, low: FloatArray, spacing: float
) -> BoolArray:
    """Find the normals that their neighbours on the same sheet contradict.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        Of a cloud, or of a region of it and all points within `MARGIN` spacings.
    normals : ndarray of float64 or float32, shape (n, 3)
        Unit length. The result does not depend on how the same numbers are held.
    low : ndarray of float64, shape (3,)
        The least coordinates of the cloud.
    spacing : float
        Of the cloud, in length units of the input.

    Returns
    -------
    ndarray of bool, shape (n,)

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
    turned = np.zeros(len(positions), np.bool_)
    if len(positions) < _FEW:
        return turned
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
            positions, mended, keys, cell_of, asked, reach, tolerance, drift, 1
        )
        wrong = verdicts == WRONG
        if wrong.any():
            turned ^= wrong
            mended = np.where(turned[:, None], -normals, normals)
        asked = (verdicts == UNSURE).astype(np.uint8)
        if not asked.any():
            break
    return turned


def share_opposed(
    positions: FloatArray, normals: FloatArray, low: FloatArray, edge: float, spacing: float
) -> float:
    """Return the share of opposite normals among those on one sheet, in boxes.

    Parameters
    ----------
    positions, normals : ndarray of float64, shape (n, 3)
        Of the points in some boxes, see `kernels.sample_boxes`; the normals have unit length.
    low : ndarray of float64, shape (3,)
        The least coordinates of the cloud.
    edge : float
        Of a box, in length units of the input.
    spacing : float
        Of the cloud, in length units of the input.

    Returns
    -------
    float
        Of pairs: 0.5 where signs are random, 2 f (1 - f) where a share f is turned round.
    """
    places = np.floor(cells_of(positions, low, edge)).astype(np.int64)
    _, boxes = number_keys(pack_places(places))
    order = np.argsort(boxes, kind="stable")
    positions, normals, boxes = positions[order], normals[order], boxes[order]
    pairs = opposed = 0
    for step in range(1, min(_PAIRS + 1, len(boxes))):
        one, other = normals[:-step], normals[step:]
        arms = positions[step:] - positions[:-step]
        offsets = [np.abs(np.einsum("ij,ij->i", arms, some)) for some in (one, other)]
        cosines = np.einsum("ij,ij->i", one, other)
        is_pair = (boxes[step:] == boxes[:-step]) & (np.abs(cosines) > 0.5)
        is_pair &= np.maximum(*offsets) <= _TOLERANCE * spacing
        pairs += int(np.count_nonzero(is_pair))
        opposed += int(np.count_nonzero(is_pair & (cosines < 0.0)))
    return opposed / max(pairs, 1)


def faces_inwards(cloud: PointCloud) -> bool:
    """Tell whether the normals of a cloud point to its middle, as those of a room do.

    Parameters
    ----------
    cloud : PointCloud
        Finite positions and unit normals. Of fewer than a hundred points, none do.

    Notes
    -----
    The mean of n . (x - c) / |x - c| is taken over boxes, each with the mean of its normals, so
    that what is scanned more densely does not decide.
    """
    if cloud.normals is None or len(cloud) < _FEWEST_JUDGED:
        return False
    every = slice(None, None, -(-len(cloud) // _SAMPLE))
    positions, normals = cloud.positions[every], cloud.normals[every]
    low, high = bound_points(positions)
    size = float((high - low).max()) / min(_BOXES, max(1.0, np.sqrt(len(positions) / 24.0)))
    places = np.floor(cells_of(positions, lay_lattice(low, size), size))
    keys = pack_places(places.astype(np.int64))
    order = np.argsort(keys, kind="stable")
    _, first = find_first(keys[order])
    counts = np.diff(np.append(first, len(keys)))[:, None]
    # (b, 3): the middle of each box's points, and the mean of their normals
    middles = np.add.reduceat(positions[order] - low, first) / counts
    means = np.add.reduceat(normals[order], first) / counts
    arms = middles - middles.mean(axis=0)
    lengths = np.linalg.norm(arms, axis=1)
    return bool(np.einsum("ij,ij->", arms, means) < _INWARD * lengths.sum())
