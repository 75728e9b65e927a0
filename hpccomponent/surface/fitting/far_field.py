"""A coarse signed distance everywhere: the sign in empty space, and what closes holes.

The normals of the cells, spread on a coarse periodic grid, are the gradient of an indicator
function; one Poisson equation, solved by FFT, gives it. Near the samples it is scaled to a signed
distance, and it is cut off one and a half grid steps from the surface.

A normal counts by the area that it stands for. Where most cells are empty, as in a deep bore that
few rays have reached, those that are not stand for their neighbours too: their normals are spread
over discs as large as their share of the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from hpccomponent.protocol.records import record
from hpccomponent.surface.kernels import integrate_normals, sample_grid
from hpccomponent.surface.types.field import FarField
from hpccomponent.surface.types.points import Float32Array, FloatArray, IntArray

__all__ = [
    "FEWEST_NODES",
    "FarFieldPart",
    "choose_nodes",
    "crop_far_field",
    "far_step",
    "restore_far_field",
    "solve_far_field",
    "spread_samples",
]

FEWEST_NODES = 128
"""Along a side."""

_MOST_NODES = 256
_BLURRED = 4.0  # standard deviations of the noise: shape that is smaller is not told from it
_PADDING = 1.5
_REACH = 1.5

_NEIGHBOURS = 16  # of a sample, from which the surface that it stands for is told
_SAME_SIDE = 0.3  # cos of the angle of two normals that may be of one sheet
_SAME_PLANE, _STEEPEST = 0.6, 0.35  # of that of neighbours; height of one over the other's plane,
_LEAST_SAMPLES = 3  # by their distance: what has less company may be an outlier
_LARGEST_AREA = 64.0  # cells that one may stand for
_LEAST_LENGTH = 0.1  # of a normal that says where its disc lies
_GOLDEN_TURN = complex(-0.7373688780783197, 0.6754902942615238)  # by the golden angle


@record("surface.far_field_part")
@dataclass(frozen=True, slots=True, eq=False)
class FarFieldPart:
    """A box of a far field.

    Parameters
    ----------
    values : ndarray of float32, shape (x, y, z)
        Of the nodes in the box.
    first : ndarray of int64, shape (3,)
        The lowest node of the box.
    nodes : int
        Along each side of the whole.
    origin, step
        See `FarField`.
    """

    values: Float32Array
    first: IntArray
    nodes: int
    origin: FloatArray
    step: float


def crop_far_field(far: FarField, low: FloatArray, high: FloatArray) -> FarFieldPart:
    """Cut out the nodes that interpolation within a box asks for.

    Parameters
    ----------
    far : FarField
    low, high : ndarray of float64, shape (3,)
        Corners of the box, in length units of the input.

    Returns
    -------
    FarFieldPart
    """
    nodes = len(far.values)
    first = np.clip(np.floor((low - far.origin) / far.step).astype(np.int64) - 1, 0, nodes - 2)
    end = np.clip(np.ceil((high - far.origin) / far.step).astype(np.int64) + 2, first + 2, nodes)
    box = tuple(slice(a, b) for a, b in zip(first, end, strict=True))
    return FarFieldPart(np.ascontiguousarray(far.values[box]), first, nodes, far.origin, far.step)


def restore_far_field(part: FarFieldPart) -> FarField:
    """Put a box of a far field back to its place; all around it is 0.

    Parameters
    ----------
    part : FarFieldPart

    Returns
    -------
    FarField
        The same as the whole within the box that was cut out, bit for bit.
    """
    values = np.zeros((part.nodes,) * 3, np.float32)
    box = tuple(slice(a, a + side) for a, side in zip(part.first, part.values.shape, strict=True))
    values[box] = part.values
    return FarField(values, part.origin, part.step)


def choose_nodes(low: FloatArray, high: FloatArray, cell_size: float, noise: float) -> int:
    """Choose how fine a far field is: no finer than what the points resolve.

    Parameters
    ----------
    low, high : ndarray of float64, shape (3,)
        Of the box that it covers, in length units of the input.
    cell_size : float
        Edge of the finest cells, in the same units.
    noise : float
        Standard deviation of the positions along the normals, in the same units.

    Returns
    -------
    int
        A power of two.
    """
    resolved = max(cell_size, _BLURRED * noise)
    return _MOST_NODES if resolved < far_step(low, high, FEWEST_NODES) else FEWEST_NODES


def far_step(low: FloatArray, high: FloatArray, nodes: int) -> float:
    """Return the step of the far field that covers a box, in length units of the input.

    Parameters
    ----------
    low, high : ndarray of float64, shape (3,)
        Of the box, in length units of the input.
    nodes : int
        Along each side.

    Returns
    -------
    float
    """
    return _PADDING * float((high - low).max()) / nodes


def solve_far_field(
    centroids: FloatArray,
    normals: FloatArray,
    box: tuple[FloatArray, FloatArray],
    size: float,
    nodes: int = FEWEST_NODES,
    threads: int = 1,
) -> FarField:
    """Solve for the coarse field of some cells of points.

    Parameters
    ----------
    centroids : ndarray of float64, shape (c, 3)
        In length units of the input.
    normals : ndarray of float64, shape (c, 3)
        Means, pointing out of the object.
    box : tuple of two ndarray of float64, shape (3,)
        Low and high corner of what the field must cover.
    size : float
        Edge of the cells, in length units of the input. It is the standard deviation of the
        Gaussian that the samples are smeared with, too; at least one grid step is taken.
    nodes : int
        Along each side, a power of two.
    threads : int
        The field does not depend on it.

    Returns
    -------
    FarField

    Notes
    -----
    The cost is that of four FFTs of all nodes; see `coarse_grid.integrate_normals`.
    """
    low, high = box
    step = far_step(low, high, nodes)
    origin = 0.5 * (low + high) - 0.5 * step * nodes
    centroids, normals = spread_samples(centroids, normals, size)
    centroids = np.clip(centroids, low, high)
    places = (centroids - origin) / step
    held = _held_rows((low - origin) / step, (high - origin) / step, nodes)
    chi = np.zeros((nodes,) * 3, np.float32)
    kept = chi[tuple(slice(*bounds) for bounds in held)]
    kept[:] = integrate_normals(places, normals, max(1.0, size / step), held, nodes, threads)
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    chi -= np.float32(sample_grid(chi, places).mean())
    rise = sample_grid(chi, places + unit) - sample_grid(chi, places - unit)
    slope = max(float(rise.mean()) / (2.0 * step), 1e-300)
    chi /= np.float32(slope)
    np.clip(chi, -_REACH * step, _REACH * step, out=chi)
    return FarField(chi, origin, step)


def spread_samples(
    centroids: FloatArray, normals: FloatArray, size: float
) -> tuple[FloatArray, FloatArray]:
    """Spread samples that stand for more than one cell over their share of the surface.

    Parameters
    ----------
    centroids, normals, size
        See `solve_far_field`.

    Returns
    -------
    centroids : ndarray of float64, shape (s, 3)
        Samples of about one cell each: first those that are as they were, then the discs.
    normals : ndarray of float64, shape (s, 3)
        As long as they count.

    Notes
    -----
    With k of the 16 nearest samples on its sheet, the farthest at distance d, a sample stands for
    pi d^2 / k: for about one cell where all are there. One whose neighbours point elsewhere stays
    as it is, for outliers must not grow.
    """
    lengths = np.linalg.norm(normals, axis=1)
    if len(centroids) < _NEIGHBOURS:
        return centroids, normals
    axes = normals / np.maximum(lengths, 1e-300)[:, None]
    distances, rows = KDTree(centroids).query(centroids, _NEIGHBOURS)
    cosines = (axes[:, None] * axes[rows]).sum(axis=2)
    heights = ((centroids[rows] - centroids[:, None]) * axes[:, None]).sum(axis=2)
    sheet = (cosines > _SAME_SIDE).sum(axis=1)
    areas = np.pi * (distances[:, -1] / size) ** 2 / np.maximum(sheet - 0.5, 0.5)
    areas = np.minimum(areas, _LARGEST_AREA)
    beside = np.abs(heights) <= _STEEPEST * np.maximum(distances, size)
    company = (beside & (cosines > _SAME_PLANE)).sum(axis=1)
    alone = (areas <= 1.0) | (company < _LEAST_SAMPLES) | (lengths < _LEAST_LENGTH)
    sparse = np.flatnonzero(~alone)
    counts = np.ceil(areas[sparse]).astype(np.int64)
    of = np.repeat(sparse, counts)
    number = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
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


def _turn(count: int) -> FloatArray:
    """Return points on the unit circle, each the golden angle on from the one before.

    By products alone: a sine has other last digits on other processors.
    """
    turns = [complex(1.0, 0.0)]
    while len(turns) < count:
        turns.append(turns[-1] * _GOLDEN_TURN)
    return np.array([(turn.real, turn.imag) for turn in turns])


def _held_rows(low: FloatArray, high: FloatArray, nodes: int) -> IntArray:
    """Return the first and the end of the planes and of the rows that hold a box and two nodes."""
    first = np.maximum(np.floor(low).astype(np.int64) - 2, 0)
    end = np.minimum(np.ceil(high).astype(np.int64) + 3, nodes)
    return np.stack([first, end], axis=1)[:2]
