"""Patches: points of one cell on one sheet, whose normals agree up to their signs.

::

    cell ── a seed, what lies on its plane ──> patch 0      the rest ── a seed ──> patch 1 ...
    near points of different patches ──> links

Cells lie on a lattice that does not depend on who looks, so that a patch is the same in whatever
region it is made of. Only patches have to be turned to their side, some ten times fewer than
points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Annotated

import numpy as np

from hpcapp.applications.surface.normals.estimation import refuse_wide
from hpcapp.applications.surface.types.result_patterns import LENGTH, UNIT
from hpcapp.geometry.axes import rotate
from hpcapp.geometry.lattice import find_first, find_keys, merge_counts, number_keys, unique_keys
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, IntArray
from hpcapp.kernels import SHEETS, group_sheets, link_groups
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.columns import Column
from hpccomponent.protocol.records import record

CELL = 4.0
"""Spacings: the edge of the cells that patches are made in."""

LINKED = 8
"""Neighbours that a point links its patch to, and one more that is itself."""
_REACH = 4.0  # spacings: farther points are no neighbours
_QUARTERS = ((-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0))
_ROUNDED = 2.0**-16  # spacings: more than distances change when positions are rounded

MARGIN = _REACH + CELL * 3.0**0.5 + _ROUNDED
"""Spacings: as far as what decides over a patch and its links lies."""


@record("surface.normal_patches")
@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Groups of p points that have one side, sorted by cell and rank."""

    keys: Annotated[IntArray, Column("p")]
    """The cell of each."""
    ranks: Annotated[IntArray, Column("p", low=0, high=SHEETS - 1)]
    """Which of the cell's patches it is."""
    counts: Annotated[IntArray, Column("p", low=1)]
    """Points in each."""
    centres: Annotated[FloatArray, Column("p", 3, unit=LENGTH)]
    """Means of the positions."""
    normals: Annotated[FloatArray, Column("p", 3, low=-UNIT, high=UNIT)]
    """Unit length; on the side of the seed."""
    noise: Annotated[FloatArray, Column("p", low=0.0, unit=LENGTH)]
    """Mean standard deviation of the points around their planes."""

    def __len__(self) -> int:
        return len(self.keys)

    def take(self, rows: IntArray) -> Patches:
        """Return those of some rows, (q,)."""
        return Patches(*(getattr(self, field.name)[rows] for field in fields(self)))

    def rotate(self, axes: FloatArray | None) -> Patches:
        """Return the same along other axes; see `axes.rotate`."""
        centres, normals = rotate(self.centres, axes), rotate(self.normals, axes)
        return replace(self, centres=centres, normals=normals)


@record("surface.patch_links")
@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Which patches touch, in l pairs."""

    first: Annotated[IntArray, Column("l", low=0)]
    """Rows of patches."""
    second: Annotated[IntArray, Column("l", low=0)]
    """Rows of those that they touch: higher ones."""
    contacts: Annotated[IntArray, Column("l", low=1)]
    """Of how many neighbours of points."""
    arms: Annotated[IntArray, Column("l", 3)]
    """From the first's points to these neighbours in the second, summed; in units of 2^-19
    spacings, so that the sums of regions are exact."""

    def rotate(self, axes: FloatArray | None) -> Links:
        """Return the same along other axes; see `axes.rotate`."""
        return replace(
            self, arms=np.rint(rotate(self.arms.astype(np.float64), axes)).astype(np.int64)
        )


@record("surface.patch_sides")
@dataclass(frozen=True, slots=True, eq=False)
class Sides:
    """On which side patches have their normals; keys and ranks are as of `Patches`.

    `values`, (p,), are above 0 where a patch's normal points out of the object, below it where it
    points inwards; the confidence, 0 to 1, is how far from 0.
    """

    keys: IntArray
    ranks: IntArray
    values: Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class _Grouped:
    """Points in patches, whose keys and ranks are as of `Patches`.

    `patch_of`, (n,), is the patch of each point; `is_opposed`, (n,), tells whether its normal is on
    the other side than its patch's.
    """

    keys: IntArray
    ranks: IntArray
    patch_of: IntArray
    is_opposed: BoolArray


def find_patches(
    positions: FloatArray,
    vectors: FloatArray | Float32Array,
    own: BoolArray,
    low: FloatArray,
    spacing: float,
    threads: int = 1,
) -> tuple[Patches, Links]:
    """Find the patches that points of a region belong to and those they touch, and the links.

    Positions (n, 3) are of a cloud, or of a region and all points within `MARGIN`, in its order;
    `own`, (n,), tells the region's. `vectors`, (n, 3), are what `estimation.estimate_normals` has
    returned of them; `low`, (3,), has the cloud's least coordinates.
    """
    grouped = _group_points(positions, vectors, low, spacing, threads)
    points = positions, own.astype(np.uint8), grouped.patch_of
    links = Links(*link_groups(*points, low, spacing, threads))
    # (g,): patches with a point of the region, or linked to one of these; what lies in the margin
    # alone is another region's to find.
    wanted = np.zeros(len(grouped.keys), np.bool_)
    for rows in (grouped.patch_of[own], links.first, links.second):
        wanted[rows] = True
    # (g,): the row of each among those that are wanted.
    row_of = np.cumsum(wanted) - 1
    kept = Links(row_of[links.first], row_of[links.second], links.contacts, links.arms)
    return _describe(grouped, positions, vectors).take(np.flatnonzero(wanted)), kept


def merge_patches(found: Sequence[tuple[Patches, Links]]) -> tuple[Patches, Links]:
    """Put together what `find_patches` found in one or more regions of a cloud, each once.

    The links are sorted.
    """
    parts = [patches for patches, _ in found]
    keys = np.concatenate([part.keys for part in parts])
    # (m,): cell and rank as one number, by which a patch that several regions found is known.
    names = number_keys(keys)[1] * SHEETS + np.concatenate([part.ranks for part in parts])
    kept, first_rows = find_first(names)
    row_of = np.searchsorted(kept, names)
    # A row of a part, shifted by the parts before it, is a row of `names`.
    starts = np.cumsum([0, *(len(part) for part in parts[:-1])])
    ends = []
    for side in ("first", "second"):
        rows = zip((getattr(links, side) for _, links in found), starts, strict=True)
        ends.append(row_of[np.concatenate([local + start for local, start in rows])])
    contacts = [np.column_stack([links.contacts, links.arms]) for _, links in found]
    # A link across a border comes from both regions, each with the contacts of its own points.
    every, sums = merge_counts(ends[0] * len(kept) + ends[1], np.concatenate(contacts))
    columns = [
        np.concatenate([getattr(part, field.name) for part in parts])[first_rows]
        for field in fields(Patches)
    ]
    links = Links(every // len(kept), every % len(kept), sums[:, 0], sums[:, 1:])
    return Patches(*columns), links


def quarter_patches(patches: Patches, reach: float) -> FloatArray:
    """Return the middles of four parts of each patch, (4 p, 3).

    `reach` is half of what lies between two of them.
    """
    rows = np.arange(len(patches))
    axes = np.zeros((len(patches), 3))
    # (p, 3): the axis that is farthest from each normal, so that their product is not near 0.
    axes[rows, np.argmin(np.abs(patches.normals), axis=1)] = 1.0
    one = np.cross(patches.normals, axes)
    one /= np.sqrt(np.einsum("ij,ij->i", one, one))[:, None]
    # (p, 3): with `one`, two unit vectors along the plane of each patch.
    other = np.cross(patches.normals, one)
    return np.concatenate(
        [patches.centres + reach * (along * one + across * other) for along, across in _QUARTERS]
    )


def turn_points(
    positions: FloatArray,
    vectors: FloatArray | Float32Array,
    low: FloatArray,
    spacing: float,
    sides: Sides,
    threads: int = 1,
) -> tuple[Float32Array, BoolArray, Float32Array]:
    """Turn normals to the sides of their patches; tell which are turned, and how sure they are.

    Positions, vectors and `low` are as for `find_patches`; `sides` are those of all patches that
    points of the region belong to. Returned are unit normals (n, 3), whether these are opposites of
    the vectors, (n,), and confidences, (n,), 0 to 1, and 0 for points of other patches.
    """
    grouped = _group_points(positions, vectors, low, spacing, threads)
    rows = _find_names(sides, grouped)
    # (n,): the side of each point's patch; 0, appended last, where that has none.
    values = np.append(sides.values, np.float32(0.0))[rows][grouped.patch_of]
    # A normal that opposes its patch stays where the patch is turned: the two signs cancel.
    is_turned = (values < 0.0) != grouped.is_opposed
    _, normals = _split(vectors)
    turned = np.where(is_turned[:, None], -normals, normals).astype(np.float32)
    return turned, is_turned, np.abs(values)


def _group_points(
    positions: FloatArray,
    vectors: FloatArray | Float32Array,
    low: FloatArray,
    spacing: float,
    threads: int,
) -> _Grouped:
    """Group the points of whole cells; what comes of cells that are not is no patch."""
    refuse_wide(positions, low, CELL * spacing)
    single = vectors.astype(np.float32, copy=False)
    points = positions, single, low, CELL * spacing, spacing
    keys, ranks, patch_of, sides = group_sheets(*points, threads)
    return _Grouped(keys, ranks, patch_of, sides.view(np.bool_))


def _find_names(sides: Sides, wanted: _Grouped) -> IntArray:
    """Return where patches stand among those with sides; beyond the last where they do not."""
    keys = unique_keys(sides.keys)
    # (p,): cell and rank as one number, rising; a cell that is not there comes after all others.
    names = find_keys(keys, sides.keys) * SHEETS + sides.ranks
    return find_keys(names, find_keys(keys, wanted.keys) * SHEETS + wanted.ranks)


def _split(vectors: FloatArray | Float32Array) -> tuple[FloatArray, FloatArray]:
    """Return the lengths of vectors, and the same ones of unit length."""
    wide = vectors.astype(np.float64)
    lengths = np.sqrt(_dot(wide, wide))
    return lengths, wide / np.maximum(lengths, 1e-300)[:, None]


def _describe(
    grouped: _Grouped, positions: FloatArray, vectors: FloatArray | Float32Array
) -> Patches:
    patch_of, count = grouped.patch_of, len(grouped.keys)
    # (n,), (n, 3): the vectors are as long as the noise of their points.
    noise, normals = _split(vectors)
    # Normals on the side of the seed: without a common side their mean would mean nothing.
    aligned = np.where(grouped.is_opposed[:, None], -normals, normals)
    directions = _means(aligned, patch_of, count)
    lengths = np.sqrt(_dot(directions, directions))
    return Patches(
        grouped.keys,
        grouped.ranks,
        np.bincount(patch_of, minlength=count),
        _means(positions, patch_of, count),
        directions / np.maximum(lengths, 1e-300)[:, None],
        _means(noise[:, None], patch_of, count)[:, 0],
    )


def _means(values: FloatArray, group_of: IntArray, groups: int) -> FloatArray:
    """Return the mean of each group, summed in the order of the rows."""
    counts = np.maximum(np.bincount(group_of, minlength=groups), 1)
    sums = [np.bincount(group_of, column, groups) for column in values.T]
    return np.stack(sums, axis=1) / counts[:, None]


def _dot(first: FloatArray, second: FloatArray) -> FloatArray:
    products = first * second
    dots: FloatArray = products[:, 0] + products[:, 1] + products[:, 2]
    return dots
