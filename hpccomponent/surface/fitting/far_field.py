"""A coarse signed distance everywhere: the sign in empty space, and what closes holes.

The normals of the cells, spread on a coarse periodic grid, are the gradient of an indicator
function; one Poisson equation, solved by FFT, gives it. Near the samples it is scaled to a signed
distance, and it is cut off one and a half grid steps from the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpccomponent.protocol.records import record
from hpccomponent.surface.kernels import integrate_normals, sample_grid
from hpccomponent.surface.types.field import FarField
from hpccomponent.surface.types.points import Float32Array, FloatArray, IntArray

__all__ = [
    "NODES",
    "FarFieldPart",
    "crop_far_field",
    "far_step",
    "restore_far_field",
    "solve_far_field",
]

NODES = 128
_PADDING = 1.5
_REACH = 1.5


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


def far_step(low: FloatArray, high: FloatArray) -> float:
    """Return the step of the far field that covers a box, in length units of the input.

    Parameters
    ----------
    low, high : ndarray of float64, shape (3,)
        Of the box, in length units of the input.

    Returns
    -------
    float
    """
    return _PADDING * float((high - low).max()) / NODES


def solve_far_field(
    centroids: FloatArray,
    normals: FloatArray,
    box: tuple[FloatArray, FloatArray],
    smoothing: float,
    threads: int = 1,
) -> FarField:
    """Solve for the coarse field of some samples.

    Parameters
    ----------
    centroids : ndarray of float64, shape (c, 3)
        In length units of the input.
    normals : ndarray of float64, shape (c, 3)
        Pointing out of the object, as long as the samples are to count.
    box : tuple of two ndarray of float64, shape (3,)
        Low and high corner of what the field must cover.
    smoothing : float
        Standard deviation of the Gaussian that the samples are smeared with, in length units of
        the input; at least one grid step is taken.
    threads : int
        The field does not depend on it.

    Returns
    -------
    FarField

    Notes
    -----
    The cost is that of four FFTs of 128^3 nodes; see `coarse_grid.integrate_normals`.
    """
    low, high = box
    step = far_step(low, high)
    origin = 0.5 * (low + high) - 0.5 * step * NODES
    places = (centroids - origin) / step
    held = _held_rows((low - origin) / step, (high - origin) / step)
    chi = np.zeros((NODES,) * 3, np.float32)
    kept = chi[tuple(slice(*bounds) for bounds in held)]
    kept[:] = integrate_normals(places, normals, max(1.0, smoothing / step), held, NODES, threads)
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    chi -= np.float32(sample_grid(chi, places).mean())
    rise = sample_grid(chi, places + unit) - sample_grid(chi, places - unit)
    slope = max(float(rise.mean()) / (2.0 * step), 1e-300)
    chi /= np.float32(slope)
    np.clip(chi, -_REACH * step, _REACH * step, out=chi)
    return FarField(chi, origin, step)


def _held_rows(low: FloatArray, high: FloatArray) -> IntArray:
    """Return the first and the end of the planes and of the rows that hold a box and two nodes."""
    first = np.maximum(np.floor(low).astype(np.int64) - 2, 0)
    end = np.minimum(np.ceil(high).astype(np.int64) + 3, NODES)
    return np.stack([first, end], axis=1)[:2]
