"""Poses that may be right, from three sources, none of which has to be.

- Directions that many normals have (walls, floors): two of one scan on two of the other.
- What is up: the z axes, or the most frequent normals, and all turns about them.
- Features of the surface around points: FasterPFH and a robust solver, by KISS-Matcher
  (https://doi.org/10.48550/arXiv.2409.15615).

The first two give turns; the shifts of each come from the correlation of both scans as voxels.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations, permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.spatial.transform import Rotation

from hpcapp.alignment.pose import make_pose
from hpcapp.alignment.sample import Cells, Sample
from hpcapp.geometry.points import FloatArray

_AXES, _LEAST_SHARE = 6, 0.02  # directions of a scan that are tried; share of the cells of each
_ALIKE, _APART = 0.985, 0.94  # cosines: of one direction, and of the next
_SQUARE = 0.06  # how far the cosine between two directions may differ in both scans
_MOST_TURNS = 60
_TURNS_ABOUT_UP = 60
_NEAR = 0.15  # radians: turns nearer to each other are one
_VOXELS = 20  # along each side of the larger scan
_PEAKS = 2  # shifts of each turn
_KEPT = 24  # poses of each source
_FEATURE_SIZES = (25, 50, 100)  # voxels along the smaller scan's diagonal
_VOXEL = 0.3  # what KISS-Matcher is tuned for: scans are scaled to it


def propose(fixed: Sample, moved: Sample, edge: float) -> Iterator[FloatArray]:
    """Yield poses of a scan in the frame of another; cells of an edge are compared."""
    cells, others = fixed.at(edge), moved.at(edge)
    directions, other_directions = find_directions(cells), find_directions(others)
    for turns in (
        match_directions(directions, other_directions),
        turn_about_up(directions, other_directions),
    ):
        yield from correlate(cells, others, turns)
    yield from match_features(fixed, moved)


def find_directions(cells: Cells) -> FloatArray:
    """Return directions that many normals have, (k, 3), the most frequent first."""
    rng = np.random.default_rng(0)
    normals = cells.normals[rng.permutation(len(cells.normals))[:2000]]
    left, directions = np.ones(len(normals), bool), list[FloatArray]()
    while len(directions) < _AXES and left.any():
        alike = np.abs(normals[left] @ normals[left].T) > _ALIKE
        members = normals[left][alike[alike.sum(axis=1).argmax()]]
        direction = np.linalg.eigh(members.T @ members)[1][:, -1]
        if len(members) < _LEAST_SHARE * len(normals):
            break
        directions.append(direction)
        left &= np.abs(normals @ direction) < _APART
    return np.reshape(directions, (-1, 3))


def match_directions(directions: FloatArray, others: FloatArray) -> list[FloatArray]:
    """Return turns that bring two directions of the others onto two of the first."""
    turns = list[FloatArray]()
    signs = (1, -1)  # a direction is the same either way round
    for (a, b), (c, d), sign, other_sign in product(
        permutations(directions, 2), combinations(others, 2), signs, signs
    ):
        first, second = sign * c, other_sign * d
        if abs(a @ b) > _APART or abs(first @ second - a @ b) > _SQUARE:
            continue
        turn = _frame(a, b) @ _frame(first, second).T
        if all(np.trace(turn.T @ one) < 1 + 2 * np.cos(_NEAR) for one in turns):
            turns.append(turn)
    return turns[:_MOST_TURNS]


def turn_about_up(directions: FloatArray, others: FloatArray) -> list[FloatArray]:
    """Return all turns about what may be up in both scans."""
    up = np.array([0.0, 0.0, 1.0])
    pairs = [(up, up)]
    if len(directions) and len(others):
        pairs += [(directions[0], others[0]), (directions[0], -others[0])]
    angles = 2 * np.pi * np.arange(_TURNS_ABOUT_UP) / _TURNS_ABOUT_UP
    about = Rotation.from_rotvec(angles[:, None] * [1.0, 0.0, 0.0]).as_matrix()
    return [
        _upright(first) @ turn @ _upright(second).T for first, second in pairs for turn in about
    ]


def correlate(fixed: Cells, moved: Cells, turns: Iterable[FloatArray]) -> list[FloatArray]:
    """Return the poses of some turns and any shift at which most cells meet their like."""
    poses = list[tuple[float, FloatArray]]()
    low, extent = fixed.positions.min(axis=0), np.ptp(fixed.positions, axis=0)
    for turn in turns:
        places, normals = moved.positions @ turn.T, moved.normals @ turn.T
        other_low, other_extent = places.min(axis=0), np.ptp(places, axis=0)
        pitch = np.maximum(np.maximum(extent, other_extent) / _VOXELS, fixed.edge)
        sides = np.floor(extent / pitch).astype(int) + 1
        other_sides = np.floor(other_extent / pitch).astype(int) + 1
        shape = tuple(fft.next_fast_len(int(n), real=True) for n in sides + other_sides)
        first = _transform((fixed.positions - low) / pitch, fixed.normals, fixed.weights, shape)
        second = _transform((places - other_low) / pitch, normals, moved.weights, shape)
        # By shift, in voxels that wrap around: how many cells meet their like.
        counts = fft.irfftn((first * second.conj()).sum(axis=0), s=shape)
        for _ in range(_PEAKS):
            peak = np.array(np.unravel_index(counts.argmax(), shape))
            steps = np.where(peak >= sides, peak - shape, peak)
            pose = make_pose(turn, low + steps * pitch - other_low)
            poses.append((float(counts[tuple(peak)]), pose))
            around = [np.arange(n - 2, n + 3) % side for n, side in zip(peak, shape, strict=True)]
            counts[np.ix_(*around)] = -np.inf
    poses.sort(key=lambda pose: -pose[0])
    return [pose for _, pose in poses[:_KEPT]]


def _transform(
    places: FloatArray, normals: FloatArray, weights: FloatArray, shape: tuple[int, ...]
) -> NDArray[np.complex64]:
    """Return cells as voxels, Fourier transformed, (6, ...): the sums of their normals' squares.

    The product of two is the sum of the squared cosines between the normals that meet.
    """
    size = int(np.prod(shape))
    voxel = np.ravel_multi_index(tuple(np.floor(places).astype(int).T), shape)
    # Of a voxel with many cells each counts less.
    count = np.sqrt(np.maximum(np.bincount(voxel, weights, size), 1e-9))
    x, y, z = normals.T
    twice = np.sqrt(2)
    squares = (x * x, y * y, z * z, twice * x * y, twice * x * z, twice * y * z)
    sums = [np.bincount(voxel, weights * square, size) / count for square in squares]
    grid = np.stack(sums).astype(np.float32).reshape(6, *shape)
    return np.asarray(fft.rfftn(grid, axes=(1, 2, 3)))


def match_features(fixed: Sample, moved: Sample) -> Iterator[FloatArray]:
    """Yield the poses that features tell, at some sizes of voxels; none without the library."""
    try:
        from kiss_matcher import KISSMatcher, KISSMatcherConfig
    except ImportError:  # it has no wheels for the newest Python
        return
    extent = min(fixed.extent, moved.extent)
    for voxels in _FEATURE_SIZES:
        size = extent / voxels
        if size < max(fixed.spacing, moved.spacing):
            continue
        matcher = KISSMatcher(KISSMatcherConfig(voxel_size=_VOXEL))
        solution = matcher.estimate(
            *(
                (one.at(size / 2).positions * (_VOXEL / size)).astype(np.float32)
                for one in (moved, fixed)
            )
        )
        yield make_pose(
            np.asarray(solution.rotation), np.asarray(solution.translation) * size / _VOXEL
        )


def _frame(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return axes, columns of (3, 3): the first, one towards the second, one square to both."""
    across = np.cross(first, second)
    across /= np.linalg.norm(across)
    return np.column_stack([first, np.cross(across, first), across])


def _upright(up: FloatArray) -> FloatArray:
    """Return axes, columns of (3, 3), of which the first is up."""
    aside = np.eye(3)[np.abs(up).argmin()]
    return _frame(up, aside)
