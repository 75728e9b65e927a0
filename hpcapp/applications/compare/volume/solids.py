"""The volume between two closed meshes: what one of them encloses and the other does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from hpcapp.applications.compare.truth import MeshTruth, sample_mesh
from hpcapp.applications.compare.volume.errors import Samples
from hpcapp.applications.compare.volume.lattice import Lattice, cross_faces
from hpcapp.applications.compare.volume.measure import (
    Change,
    Volume,
    measure_samples,
    name_shift,
    widen,
)
from hpcapp.applications.surface.stitching.topology import signed_volume
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray

_SAMPLES = 50_000  # of the new surface
_NEIGHBOURS = 6
_COLUMNS = 800  # along the longer side


def measure_solids(new: Mesh, old: Mesh, registration: float | None, step: float | None) -> Change:
    """Measure what changed between two closed meshes that face outwards.

    Cut and fill are what only one of them encloses, along upright lines through both. The share of
    it that lies where no change is told may be errors: it is uncertain.

    Parameters
    ----------
    registration : float, optional
        See `find_errors`.
    step : float, optional
        Between the lines, in length units.
    """
    samples, positions = _sample_change(new, old)
    errors, side, (cut, fill, net) = measure_samples(
        samples, _pair_nearest(positions), registration
    )
    doubtful = _share_unchanged(samples, side)
    every = np.arange(_SAMPLES)
    bias = errors.sum_bias(samples, every)
    bound = bias + errors.sum_noise(samples, every)
    net = Volume(signed_volume(new) - signed_volume(old), bound, bias, net.area)
    low, high = bound_points(np.concatenate([new.vertices, old.vertices]))
    width = step or float((high - low)[:2].max()) / _COLUMNS
    changes = []
    for one in (width, 2.0 * width):
        gone, added = _sum_columns(new, old, Lattice.over(low[:2], high[:2], one)).tolist()
        changes.append(Change(
            "closed",
            replace(cut, volume=gone, uncertainty=cut.uncertainty + doubtful[0] * gone),
            replace(fill, volume=added, uncertainty=fill.uncertainty + doubtful[1] * added),
            net, samples.area * _SAMPLES, 0.0, 0.0, 0.0, name_shift(errors.shift),
            float(errors.shift[3]), registration, errors.noise,
            float(np.median(errors.detect(samples))), one,
        ))  # fmt: skip
    return widen(changes[0], changes[1])


def _share_unchanged(samples: Samples, side: IntArray) -> tuple[float, float]:
    """Return how much of the volume behind, and in front, of the old surface is no told change."""
    shares = []
    for sign in (-1, 1):
        volume = np.maximum(sign * samples.change, 0.0)
        whole = float(volume.sum())
        shares.append(float(volume[side != sign].sum()) / whole if whole else 0.0)
    return shares[0], shares[1]


def _sample_change(new: Mesh, old: Mesh) -> tuple[Samples, FloatArray]:
    """Return how far the new surface is in front of the old one, and where."""
    cloud = sample_mesh(new, _SAMPLES)
    assert cloud.normals is not None  # noqa: S101 - faces have some
    truth = MeshTruth(old)
    sides = truth.find_sides(cloud.positions)
    assert sides is not None  # noqa: S101 - it is closed
    corners = new.vertices[new.faces]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * float(np.linalg.norm(crosses, axis=1).sum()) / _SAMPLES
    samples = Samples(
        sides * truth.distance(cloud.positions),
        np.column_stack([cloud.normals, np.ones(_SAMPLES)]),
        cloud.positions / np.sqrt(area), area, np.ones(_SAMPLES), np.zeros(_SAMPLES),
    )  # fmt: skip
    return samples, cloud.positions


def _sum_columns(new: Mesh, old: Mesh, lattice: Lattice) -> FloatArray:
    """Return what only the old mesh encloses, and what only the new one does."""
    hits = [
        (cells, heights, facing, np.full(len(cells), owner))
        for owner, mesh in enumerate((old, new))
        for cells, heights, facing in cross_faces(mesh, lattice)
    ]
    cells, heights, facing, owner = (np.concatenate(column) for column in zip(*hits, strict=True))
    order = np.lexsort((heights, cells))
    cells, heights, facing, owner = cells[order], heights[order], facing[order], owner[order]
    # (2, m): whether each mesh is entered and not yet left, upwards from a hit
    inside = np.stack([np.cumsum(np.where(owner == k, -facing, 0.0)) > 0.5 for k in (0, 1)])
    rise = np.where(np.diff(cells) == 0, np.diff(heights), 0.0) * lattice.step**2
    only = inside[:, :-1] & ~inside[::-1, :-1]
    volumes: FloatArray = (only * rise).sum(axis=1)
    return volumes


def _pair_nearest(positions: FloatArray) -> IntArray:
    """Return pairs of neighbours, shape (p, 2)."""
    nearest = KDTree(positions).query(positions, k=_NEIGHBOURS + 1)[1]
    first = np.repeat(np.arange(len(positions)), _NEIGHBOURS)
    return np.stack([first, nearest[:, 1:].ravel()], axis=1)
