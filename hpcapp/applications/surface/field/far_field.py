"""A coarse signed distance everywhere: the sign in empty space, and what closes holes.

The normals of the cells, spread on a coarse periodic grid, are the gradient of an indicator
function; one Poisson equation, solved by FFT, gives it. Near the samples it is scaled to a signed
distance, and it is cut off one and a half grid steps from the surface.

A normal counts by the area that it stands for. Where most cells are empty, as in a deep bore that
few rays have reached, those that are not stand for their neighbours too: their normals are spread
over discs as large as their share of the surface.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hpcapp.applications.surface.field.hull import find_hull
from hpcapp.applications.surface.types.result_patterns import LENGTH
from hpcapp.geometry.lattice import (
    OCTANTS,
    ancestor_keys,
    find_keys,
    lay_lattice,
    number_keys,
    pack_places,
)
from hpcapp.geometry.points import Float32Array, FloatArray, IntArray
from hpcapp.kernels import integrate_normals, sample_grid
from hpcapp.kernels.types.field import FarField
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.columns import Column
from hpccomponent.protocol.records import record

_PADDING = 1.5

FAR_REACH = 1.5
"""Steps: the values are cut off there."""

FEWEST_NODES = 128
"""Of a far field, along a side."""

_ENOUGH = 6.0  # samples on one sheet, from which the area of each is told
_WIDEST = 5  # the level of cells up to which they are looked for
_PER_SQUARE = 1.5  # samples of a whole sheet in a cube, by the square of its edge in cells
_OF_TUBE, _OF_SHEET = 0.5, 0.8  # mean cos^2 of the angles of its normals to one of them
_PAIRS, _TWICE = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)), (1.0, 1.0, 1.0, 2.0, 2.0, 2.0)
_EXACT = 1e-6  # where the samples of a plane count and stand for whole numbers
_LARGEST_AREA = 64.0  # cells that one may stand for
_LEAST_LENGTH = 0.1  # of a normal that says where its disc lies
_GOLDEN_TURN = complex(-0.7373688780783197, 0.6754902942615238)  # by the golden angle


@record("surface.far_field_part")
@dataclass(frozen=True, slots=True, eq=False)
class FarFieldPart:
    """A box of a far field, of x times y times z nodes."""

    values: Annotated[Float32Array, Column("x", "y", "z", unit=LENGTH)]
    """Of the nodes in the box."""
    first: Annotated[IntArray, Column(3)]
    """The lowest node of the box."""
    nodes: int
    """Along each side of the whole."""
    origin: Annotated[FloatArray, Column(3, unit=LENGTH)]
    step: float
    hull: Annotated[FloatArray, Column("k", 4)]
    """See `FarField`."""


def crop_far_field(far: FarField, low: FloatArray, high: FloatArray) -> FarFieldPart:
    """Cut out the nodes that interpolation within a box asks for."""
    nodes = len(far.values)
    first, end = crop_nodes(far.origin, far.step, nodes, low, high)
    box = tuple(slice(a, b) for a, b in zip(first, end, strict=True))
    values = np.ascontiguousarray(far.values[box])
    return FarFieldPart(values, first, nodes, far.origin, far.step, far.hull)


def crop_nodes(
    origin: FloatArray, step: float, nodes: int, low: FloatArray, high: FloatArray
) -> tuple[IntArray, IntArray]:
    """Return the first and the end of the nodes that interpolation within a box asks for."""
    # Two nodes or more along each axis, wherever the box lies: interpolation asks for them.
    first = np.clip(np.floor((low - origin) / step).astype(np.int64) - 1, 0, nodes - 2)
    end = np.clip(np.ceil((high - origin) / step).astype(np.int64) + 2, first + 2, nodes)
    return first, end


def restore_far_field(part: FarFieldPart) -> FarField:
    """Put a box of a far field back to its place, bit for bit; all around it is 0."""
    values = np.zeros((part.nodes,) * 3, np.float32)
    box = tuple(slice(a, a + side) for a, side in zip(part.first, part.values.shape, strict=True))
    values[box] = part.values
    return FarField(values, part.origin, part.step, part.hull)


def far_step(low: FloatArray, high: FloatArray, nodes: int) -> float:
    """Return the step of the far field that covers a box, in length units of the input."""
    return _PADDING * float((high - low).max()) / nodes


def lay_far_field(low: FloatArray, high: FloatArray, nodes: int) -> tuple[FloatArray, float]:
    """Return where node (0, 0, 0) of the far field that covers a box lies, and its step."""
    step = far_step(low, high, nodes)
    return 0.5 * (low + high) - 0.5 * step * nodes, step


def solve_far_field(
    centroids: FloatArray,
    normals: FloatArray,
    box: tuple[FloatArray, FloatArray],
    size: float,
    nodes: int,
    missing: FloatArray,
    threads: int = 1,
) -> FarField:
    """Solve for the coarse field of some cells of points, at the cost of four FFTs of all nodes.

    Centroids and mean normals, pointing out of the object, are (c, 3), in length units of the
    input; the `box` has the corners of what the field must cover, by so many `nodes` along each
    side, a power of two. The samples are smeared with a Gaussian whose standard deviation is the
    `size` of the cells, but at least one grid step. `missing` (3,) is as of the cloud's `Reading`.
    """
    low, high = box
    origin, step = lay_far_field(low, high, nodes)
    corner = lay_lattice(low, size)
    hull = find_hull(centroids, normals, size, missing)
    centroids, normals = spread_samples(centroids - corner, normals, size)
    # (s, 3): discs may reach beyond the box that the field covers.
    centroids = np.clip(centroids + corner, low, high)
    places = (centroids - origin) / step  # (s, 3): in steps from node (0, 0, 0)
    # (g, g, g): an indicator whose gradient the normals are; 0 where neither box nor samples are.
    bounds = _bound_rows((low - origin) / step, (high - origin) / step, nodes)
    chi = np.zeros((nodes,) * 3, np.float32)
    kept = chi[tuple(slice(*run) for run in bounds)]
    kept[:] = integrate_normals(places, normals, max(1.0, size / step), bounds, nodes, threads)
    # Made a distance: 0 at the samples in their mean, and of slope 1 across them, a step each way.
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    chi -= np.float32(sample_grid(chi, places).mean())
    rise = sample_grid(chi, places + unit) - sample_grid(chi, places - unit)
    # In values by length: the two places of each sample are two steps apart.
    slope = max(float(rise.mean()) / (2.0 * step), 1e-300)
    chi /= np.float32(slope)
    np.clip(chi, -FAR_REACH * step, FAR_REACH * step, out=chi)
    return FarField(chi, origin, step, hull)


def spread_samples(
    centroids: FloatArray, normals: FloatArray, size: float
) -> tuple[FloatArray, FloatArray]:
    """Spread samples that stand for more than one cell over their share of the surface.

    `centroids` (c, 3) count from a corner of a lattice of such cells. Return centroids (s, 3) of
    samples of about one cell each, first those that are as they were, then the discs, and normals
    (s, 3), as long as they count.

    A whole sheet leaves about 1.5 a^2 samples in a cube of a cells along an edge. Where there are k
    of them, in the smallest cube with 6 or more, each stands for 1.5 a^2 / k cells. Samples of the
    same sheet count 1, those of one that faces the other way 0. Around an outlier the smallest such
    cube reaches the dense samples of the surface: so it stands for few cells. Where normals turn
    all around, as of a tube thinner than the cube, there is no sheet: nothing is spread, or it
    would go on beyond the tube's end.
    """
    lengths = np.linalg.norm(normals, axis=1)
    axes = normals / np.maximum(lengths, 1e-300)[:, None]
    areas = _find_areas(centroids / size, axes)
    alone = (areas <= 1.0 + _EXACT) | (lengths < _LEAST_LENGTH)
    sparse = np.flatnonzero(~alone)
    # (d,): each sample once for each cell that it stands for, and the how-manieth of these it is.
    counts = np.ceil(areas[sparse] - _EXACT).astype(np.int64)
    of = np.repeat(sparse, counts)
    number = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
    # (d, 2): a sunflower of as much area, in a plane across the normal.
    share = (number + 0.5) / np.repeat(counts, counts)
    turns = (size * np.sqrt(areas[of] * share / np.pi))[:, None] * _turn(int(_LARGEST_AREA))[number]
    across = np.cross(axes[of], np.eye(3)[np.argmin(np.abs(axes[of]), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(axes[of], across)
    discs = centroids[of] + turns[:, :1] * across + turns[:, 1:] * along
    weights = areas[of] / np.repeat(counts, counts)
    return (
        np.concatenate([centroids[alone], discs]),
        np.concatenate([normals[alone], normals[of] * weights[:, None]]),
    )


def _find_areas(places: FloatArray, axes: FloatArray) -> FloatArray:
    """Tell for how many cells each sample stands; `places` are in cells, `axes` unit normals.

    The cubes are eight cells of a coarser level, which meet at its corner next to the sample.
    """
    keys = pack_places(np.floor(places).astype(np.int64))
    # (c,), and the rows of samples around which too few have been found so far.
    areas, open_rows = np.ones(len(places)), np.arange(len(places))
    # (c, 6): of each normal n, the entries of n n^T: their sum tells the mean cos^2 to any axis.
    products = np.stack([axes[:, i] * axes[:, j] for i, j in _PAIRS], axis=1)
    # (k + 1, 10): how many, their normals and these products, in each cell; 0 of a missing one.
    cells, sums = keys, np.column_stack([np.ones(len(places)), axes, products])
    for level in range(1, _WIDEST + 1):
        cells, number = number_keys(ancestor_keys(cells, 1))
        sums = np.stack(
            [np.bincount(number, of[: len(number)], len(cells) + 1) for of in sums.T], 1
        )
        lower = np.floor(places[open_rows] / 2.0**level - 0.5).astype(np.int64)
        around = np.zeros((len(open_rows), 10))
        for octant in OCTANTS:
            around += sums[find_keys(cells, pack_places(lower + octant))]
        count = np.maximum(around[:, 0], 1.0)
        # (m,): samples of the same sheet, (1 + cos) / 2 each; and whether it is a sheet at all.
        sheet = 0.5 * (count + (around[:, 1:4] * axes[open_rows]).sum(axis=1))
        straight = (around[:, 4:] * products[open_rows] * _TWICE).sum(axis=1) / count  # mean cos^2
        is_sheet = np.clip((straight - _OF_TUBE) / (_OF_SHEET - _OF_TUBE), 0.0, 1.0)
        enough = sheet >= _ENOUGH - _EXACT
        # (e,): samples that a whole sheet leaves in the cube, which is 2^(level + 1) cells wide.
        squares = _PER_SQUARE * 4.0 ** (level + 1) * is_sheet[enough]
        areas[open_rows[enough]] = squares / sheet[enough]
        open_rows = open_rows[~enough]
    return np.minimum(areas, _LARGEST_AREA)


def _turn(count: int) -> FloatArray:
    """Return points on the unit circle, each the golden angle on from the one before.

    By products alone: a sine has other last digits on other processors.
    """
    turns = [complex(1.0, 0.0)]
    while len(turns) < count:
        turns.append(turns[-1] * _GOLDEN_TURN)
    return np.array([(turn.real, turn.imag) for turn in turns])


def _bound_rows(low: FloatArray, high: FloatArray, nodes: int) -> IntArray:
    """Return the first and the end of the planes and of the rows that hold a box and two nodes."""
    first = np.maximum(np.floor(low).astype(np.int64) - 2, 0)
    end = np.minimum(np.ceil(high).astype(np.int64) + 3, nodes)
    return np.stack([first, end], axis=1)[:2]
