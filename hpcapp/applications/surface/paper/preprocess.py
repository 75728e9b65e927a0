"""The paper's preprocessing: outliers out, noise off, even density; each step by itself.

Every step takes a cloud and returns another; the input stays as it is. The same cloud gives the
same bits.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpccomponent.errors import InputError, UsageError

#: Points whose neighbourhoods are held in memory at once.
CHUNK = 20_000


def remove_outliers(cloud: PointCloud, neighbours: int = 16, deviations: float = 3.0) -> PointCloud:
    """Drop points that lie far from their neighbours (statistical outlier removal).

    A point goes where its mean distance to so many nearest neighbours exceeds the cloud's mean of
    these by more than so many of their standard deviations. A cloud of `neighbours` points or
    fewer is returned as it is: nothing can be said of it.

    References
    ----------
    Rusu et al., Towards 3D point cloud based object maps for household environments, 2008,
    doi:10.1016/j.robot.2008.08.005.
    """
    if len(cloud) <= neighbours:
        return cloud
    distances, _ = cKDTree(cloud.positions).query(cloud.positions, k=neighbours + 1)
    reach = distances[:, 1:].mean(axis=1)
    return cloud.take(reach <= reach.mean() + deviations * reach.std())


def denoise(cloud: PointCloud, neighbours: int = 24) -> PointCloud:
    """Project every point onto a quadric surface through its neighbourhood (moving least squares).

    The points, in their order, get the normals of the surfaces they are moved to. A neighbourhood
    has `neighbours` points, itself included, or all of a smaller cloud. InputError where there are
    no normals, UsageError where there are fewer than 6 neighbours.

    Notes
    -----
    Over the plane through the weighted centroid across the weighted mean normal a height function
    ``h = a + b u + c v + d uu + e uv + f vv`` is fitted with Gaussian weights whose width is half
    the distance of the farthest neighbour. Neighbours that look the other way (normals at more
    than 90 degrees) have no say, so that the two sides of a thin sheet stay apart. A neighbourhood
    with too few points of its own side, or without extent, keeps its point.
    A mean over neighbours flattens curvature; the quadratic terms keep the flattening to the
    fourth order in the neighbourhood's size.

    References
    ----------
    Levin, Mesh-independent surface interpolation, 2003, doi:10.1007/978-3-662-07443-5_3.
    """
    if neighbours < 6:
        raise UsageError(f"{neighbours} neighbours for denoising", "give 6 or more")
    positions, normals = cloud.positions, _normals_of(cloud, "denoise")
    k = min(neighbours, len(cloud))
    if k < 6:
        return cloud
    tree = cKDTree(positions)
    moved, turned = np.empty_like(positions), np.empty_like(normals)
    for start in range(0, len(cloud), CHUNK):
        rows = np.arange(start, min(start + CHUNK, len(cloud)))
        distances, near = tree.query(positions[rows], k=k)
        moved[rows], turned[rows] = _project(positions, normals, rows, near, distances)
    return replace(cloud, positions=moved, normals=turned)


def resample(cloud: PointCloud, spacing: float | None = None) -> PointCloud:
    """Thin the cloud to one point for each voxel, for an even density.

    Of every voxel with points the one nearest to their mean stays (the first of several), in the
    order of the input: a point that was measured, with its own normal and colour. The voxels' side
    is `spacing`, by default the median distance between nearest neighbours; sparser places stay.
    UsageError where it is not positive, or too small for the cloud's extent.
    """
    if len(cloud) < 2:
        return cloud
    side = measure_spacing(cloud.positions) if spacing is None else spacing
    if spacing is None and side == 0.0:
        return cloud
    if not side > 0.0:
        raise UsageError(f"the spacing is {side}", "give a positive length in units of the input")
    low = cloud.positions.min(axis=0)
    cells = np.floor((cloud.positions - low) / side)
    if cells.max() >= 2**20:
        raise UsageError(
            f"a spacing of {side:g} makes more than 2^20 voxels along a side", "give a larger one"
        )
    i, j, k = cells.astype(np.int64).T
    return cloud.take(_nearest_to_means(cloud.positions, (i << 40) | (j << 20) | k))


def measure_spacing(positions: FloatArray) -> float:
    """Return the median distance from each of two or more points to its nearest neighbour."""
    distances, _ = cKDTree(positions).query(positions, k=2)
    return float(np.median(distances[:, 1]))


def _normals_of(cloud: PointCloud, step: str) -> FloatArray:
    if cloud.normals is None:
        raise InputError(f"the cloud has no normals, which {step} needs", "give a cloud with them")
    return cloud.normals


def _project(
    positions: FloatArray,
    normals: FloatArray,
    rows: IntArray,
    near: IntArray,
    distances: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the points `rows` moved onto their surfaces, and these surfaces' normals there."""
    # (n, 1): the width of each Gaussian; (n, k): the weights of the k neighbours
    width = 0.5 * distances[:, -1:]
    lone = width[:, 0] <= 0.0
    weights = np.exp(-((distances / np.where(lone[:, None], 1.0, width)) ** 2))
    # (n, k): whether a neighbour looks the same way; `lone`, (n,), whether too few do
    facing = np.einsum("nki,ni->nk", normals[near], normals[rows]) > 0.0
    weights *= facing
    lone |= facing.sum(axis=1) < 6
    weights[lone] = 1.0

    shares = weights / weights.sum(axis=1, keepdims=True)
    # (n, 3): weighted centroids and mean normals, the latter of unit length
    center = np.einsum("nk,nki->ni", shares, positions[near])
    axis = np.einsum("nk,nki->ni", shares, normals[near])
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    lone |= length[:, 0] <= 1e-12
    axis = np.where(lone[:, None], (0.0, 0.0, 1.0), axis / np.where(length > 0.0, length, 1.0))
    # (n, 3) each: with `axis` a right-angled frame for every neighbourhood
    first, second = _tangents(axis)

    unit = np.where(lone[:, None], 1.0, width)
    # (n, k, 3): neighbours about the centroid, in widths; (n, k): their u, v and height
    offset = (positions[near] - center[:, None]) / unit[:, :, None]
    u, v, h = (np.einsum("nki,ni->nk", offset, t) for t in (first, second, axis))
    # (n, 6): the quadratic of each neighbourhood, and the point's own place in it, (n,)
    c = _fit_heights(u, v, h, shares)

    local = (positions[rows] - center) / unit
    u0, v0 = (local * first).sum(axis=1), (local * second).sum(axis=1)
    # (n,): the surface's height at the point, and its slopes along both tangents
    height = c[:, 0] + c[:, 1] * u0 + c[:, 2] * v0
    height += c[:, 3] * u0 * u0 + c[:, 4] * u0 * v0 + c[:, 5] * v0 * v0
    slope_u = c[:, 1] + 2.0 * c[:, 3] * u0 + c[:, 4] * v0
    slope_v = c[:, 2] + 2.0 * c[:, 5] * v0 + c[:, 4] * u0
    # (n, 3): the normal of the surface there, and the point on it in the cloud's frame
    normal = axis - slope_u[:, None] * first - slope_v[:, None] * second
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    point = center + unit * (u0[:, None] * first + v0[:, None] * second + height[:, None] * axis)
    keep = lone[:, None]
    return np.where(keep, positions[rows], point), np.where(keep, normals[rows], normal)


def _fit_heights(u: FloatArray, v: FloatArray, h: FloatArray, shares: FloatArray) -> FloatArray:
    """Return weighted least-squares quadratics h(u, v), shape (n, 6)."""
    # (n, k, 6): the quadratic's terms at each neighbour; (n, 6, 6): the normal equations
    columns = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2)
    weighted = columns * shares[:, :, None]
    gram = np.einsum("nki,nkj->nij", weighted, columns)
    # Neighbours along a line leave the quadratic undecided; the ridge then prefers the flat one.
    gram += 1e-9 * np.eye(6)
    rhs = np.einsum("nki,nk->ni", weighted, h)
    solved: FloatArray = np.linalg.solve(gram, rhs[:, :, None])[:, :, 0]
    return solved


def _tangents(axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors that stand square on each axis and on each other."""
    helper = np.eye(3)[np.abs(axis).argmin(axis=1)]
    first = np.cross(axis, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(axis, first)


def _nearest_to_means(positions: FloatArray, keys: IntArray) -> IntArray:
    """Return, for each group of equal keys, the point nearest to the group's mean, ascending."""
    # (n,): the points group by group, those of a group in their order
    by_key = np.argsort(keys, kind="stable")
    # (g,): where each group begins, and its size; (n,): the group of each point
    first = np.flatnonzero(np.r_[True, np.diff(keys[by_key]) != 0])
    counts = np.diff(np.r_[first, len(keys)])
    owner = np.repeat(np.arange(len(first)), counts)
    local = positions[by_key]
    # (g, 3): the mean of each group; (n,): the squared distance of each point from it
    means = np.add.reduceat(local, first, axis=0) / counts[:, None]
    away = ((local - means[owner]) ** 2).sum(axis=1)
    nearest = np.lexsort((away, owner))  # stable, so the first of equals stays first
    return np.sort(by_key[nearest[first]])
