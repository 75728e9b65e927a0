"""Edges and corners: vertices that no finer ones lie around, and whose points fall into pieces.

They are few: what is known of them stands beside the level. Where one quadric agrees with its
points' normals, nothing is asked.
"""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.field.cell_points import SortedPoints
from hpcapp.geometry.lattice import ancestor_keys, find_layers, unpack_keys
from hpcapp.geometry.points import Float32Array, IntArray
from hpcapp.kernels import BASIS
from hpcapp.kernels.types.field import PIECES, Features

_REACH = 3  # cells on each side of a vertex that the fits look at (see `fit_features`)
_ROUND = 0.04  # misfit of a quadric (see `hermite.evaluate_misfits`), some 11 degrees
_NONE = 255  # joints of a vertex where one quadric does


def find_features(
    vertices: IntArray,
    misfits: Float32Array,
    noise: float,
    cells: IntArray,
    points: SortedPoints,
    threads: int = 1,
) -> Features:
    """Fit joined quadrics where one quadric would round an edge or a corner off.

    `vertices` (v,), one or more, are sorted keys of the cells' corners, `cells` (c,) those of the
    occupied cells. Where the `misfits` (v,) of their quadrics are small, one quadric does (see
    `hermite.evaluate_misfits`). `noise` is the variance of the positions along the normals, in
    cells squared.
    """
    asked = vertices[misfits > _ROUND]
    # Keys sort by x first: one run of cells has all that lie within reach.
    low, high = unpack_keys(vertices[[0, -1]])[:, 0].tolist()
    run = find_layers(cells, low - _REACH, high + _REACH - 1)
    local, normals, offsets = points.place(run)
    given = asked, cells[run], offsets, local, normals, noise
    pieces, joints = kernels.fit_features(*given, threads)
    is_joined = joints < _NONE
    return Features(asked[is_joined], pieces[is_joined], joints[is_joined])


def find_features_above(
    vertices: IntArray,
    misfits: Float32Array,
    noise: float,
    depth: int,
    cells: IntArray,
    points: SortedPoints,
    threads: int = 1,
) -> Features:
    """Do the same on a coarser level than that by whose cells the points are sorted.

    The level's cells are halved `depth` times for the points' `cells` (c,), which are sorted keys;
    the rest is of the level.
    """
    asked = misfits > _ROUND
    if not asked.any():
        return join_features([])
    # Cells of the level that the fits look at; then the points' cells that lie in these.
    near = kernels.spread_keys(vertices[asked], -_REACH, _REACH - 1)
    is_near = kernels.find_keys(near, ancestor_keys(cells, depth)) < len(near)
    above = points.gather(np.flatnonzero(is_near), cells, depth)
    return find_features(vertices[asked], misfits[asked], noise, *above, threads)


def join_features(parts: list[Features]) -> Features:
    """Join the features of runs of vertices, one after the other."""
    none = Features(
        np.empty(0, np.int64), np.empty((0, PIECES, BASIS), np.float32), np.empty(0, np.uint8)
    )
    parts = [none, *parts]
    return Features(
        np.concatenate([part.keys for part in parts]),
        np.concatenate([part.pieces for part in parts]),
        np.concatenate([part.joints for part in parts]),
    )
