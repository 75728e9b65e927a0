"""Facets: the points of one cell that face one way, some thousand of them in a whole scan.

What is asked of the shape of a scan is asked of them. They come of exact sums, so that they are
the same in whatever regions a cloud is gone through.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.normals.patches import CELL, Patches
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.applications.surface.types.result_patterns import CellKeys
from hpcapp.geometry.lattice import cells_of, number_keys, unpack_keys
from hpcapp.geometry.points import Float32Array, FloatArray, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.columns import Column
from hpccomponent.protocol.records import record

_FACINGS = 6  # the axes that a normal may be nearest to, each way
_STEPS = 2.0**20  # of a cell's edge, and of a unit normal: whole numbers add up exactly
_AT_ONCE = 1 << 17  # points, of which what is made stays in the cache
_EACH = 128  # points of a facet, about
_FEWEST, _MOST = 1000, 6000  # facets, about
_PER_SQUARE = 1.5  # cells that a surface touches, by its area in faces of a cell


@record("surface.facets")
@dataclass(frozen=True, slots=True, eq=False)
class Facets:
    """Sums over the points of c cells, by the axis that their normals are nearest to."""

    keys: CellKeys
    sums: Annotated[FloatArray, Column("c", _FACINGS, 7)]
    """Of 1, and of positions in the cell and normals in steps."""


def choose_edge(points: int, spacing: float) -> float:
    """Return the edge of cells that make some thousand facets, in length units of the input."""
    wanted = min(max(points / _EACH, _FEWEST), _MOST)
    return spacing * max(CELL, float(np.sqrt(_PER_SQUARE * points / wanted)))


def gather_facets(
    positions: FloatArray, normals: FloatArray | Float32Array, low: FloatArray, edge: float
) -> Facets:
    """Sum up points in cells; `low` is the corner of one."""
    found = [
        _gather(positions[start : start + _AT_ONCE], normals[start : start + _AT_ONCE], low, edge)
        for start in range(0, len(positions), _AT_ONCE)
    ]
    return merge_facets(found)


def _gather(
    positions: FloatArray, normals: FloatArray | Float32Array, low: FloatArray, edge: float
) -> Facets:
    keys, _, cell_of = kernels.count_cells(positions, low, edge)
    columns = [np.rint(column * _STEPS) for column in normals.astype(np.float64).T]
    x, y, z = map(np.abs, columns)
    axes = np.where(z >= np.maximum(x, y), 2, np.where(y >= x, 1, 0))
    # (n,): the normal's largest component, whose axis and sign name the facet.
    largest = np.choose(axes, columns)
    names = cell_of * _FACINGS + 2 * axes + (largest < 0.0)
    places = cells_of(positions, low, edge)
    within = np.rint((places - np.floor(places)) * _STEPS)
    count = len(keys) * _FACINGS
    sums = [
        np.bincount(names, column, count) for column in (np.ones(len(names)), *within.T, *columns)
    ]
    stacked: FloatArray = np.stack(sums, axis=1).astype(np.float64)
    return Facets(keys, stacked.reshape(-1, _FACINGS, 7))


def merge_facets(found: Sequence[Facets]) -> Facets:
    """Put together what was summed up of the regions of a cloud."""
    if len(found) == 1:
        return found[0]
    keys, rows = number_keys(np.concatenate([some.keys for some in found]))
    sums = np.zeros((len(keys), _FACINGS, 7))
    np.add.at(sums, rows, np.concatenate([some.sums for some in found]))
    return Facets(keys, sums)


@dataclass(frozen=True, slots=True, eq=False)
class FacetShape:
    """The facets of a whole cloud, and minus their mean normal by area (3,): what is `missing`.

    `CELL` squared points are the area of a face of a cell, and `CELL` times the `spacing` is its
    edge.
    """

    patches: Patches
    spacing: float
    missing: FloatArray

    @classmethod
    def of(cls, facets: Facets, low: FloatArray, edge: float, scale: LocalScale) -> FacetShape:
        """Describe the facets of a whole cloud, of cells from `low`."""
        cells, facings = np.nonzero(facets.sums[:, :, 0])
        sums = facets.sums[cells, facings]
        counts, means = sums[:, 0], sums[:, 1:] / sums[:, :1] / _STEPS
        keys: IntArray = facets.keys[cells]
        centres = low + edge * (unpack_keys(keys) + means[:, :3])
        # (f,): each point stands for the square of the spacing around it.
        areas = counts * scale.at(centres) ** 2
        lengths = np.sqrt(np.einsum("ij,ij->i", means[:, 3:], means[:, 3:]))
        units = means[:, 3:] / np.maximum(lengths, 1e-300)[:, None]
        full = np.maximum(np.rint(areas * (CELL / edge) ** 2), 1.0).astype(np.int64)
        patches = Patches(keys, facings, full, centres, units, np.zeros(len(keys)))
        missing: FloatArray = -(areas[:, None] * means[:, 3:]).sum(axis=0) / areas.sum()
        return cls(patches, edge / CELL, missing)
