"""A coarse signed distance everywhere: the sign in empty space, and what closes holes.

The normals of the cells, spread on a coarse periodic grid, are the gradient of an indicator
function; one Poisson equation, solved by FFT, gives it. Near the samples it is scaled to a signed
distance, and it is cut off one and a half grid steps from the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.points import FloatArray, IntArray

__all__ = ["FarField", "sample_grid", "solve_far_field"]

_NODES = 128
_PADDING = 1.5
_REACH = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class FarField:
    """Signed distances on a coarse cubic grid.

    Parameters
    ----------
    values : ndarray of float32, shape (g, g, g)
        In length units of the input, positive outside, at most 1.5 steps large.
    origin : ndarray of float64, shape (3,)
        Where node (0, 0, 0) lies.
    step : float
        Distance of neighbouring nodes, in length units of the input.
    """

    values: NDArray[np.float32]
    origin: FloatArray
    step: float


def solve_far_field(
    centroids: FloatArray,
    normals: FloatArray,
    box: tuple[FloatArray, FloatArray],
    smoothing: float,
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

    Returns
    -------
    FarField

    Notes
    -----
    chi^ = -i k . V^ / k^2 for the vector field V; the cost is four FFTs of 128^3 nodes.
    """
    low, high = box
    edge = _PADDING * float((high - low).max())
    step = edge / _NODES
    origin = 0.5 * (low + high) - 0.5 * edge
    places = (centroids - origin) / step
    chi = _integrate(_spread(places, normals), max(1.0, smoothing / step))
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    chi -= sample_grid(chi, places).mean()
    rise = sample_grid(chi, places + unit) - sample_grid(chi, places - unit)
    slope = max(float(rise.mean()) / (2.0 * step), 1e-300)
    distances = np.clip(chi / slope, -_REACH * step, _REACH * step)
    return FarField(distances.astype(np.float32), origin, step)


def _corner_weights(places: FloatArray) -> list[tuple[IntArray, FloatArray]]:
    """Return the flat index and the trilinear weight of the eight nodes around each place."""
    lower = np.clip(np.floor(places).astype(np.int64), 0, _NODES - 2)
    local = places - lower
    corners = []
    for octant in range(8):
        bits = [octant >> axis & 1 for axis in range(3)]
        factors = [local[:, a] if bit else 1.0 - local[:, a] for a, bit in enumerate(bits)]
        x, y, z = (lower[:, a] + bit for a, bit in enumerate(bits))
        corners.append(((x * _NODES + y) * _NODES + z, factors[0] * factors[1] * factors[2]))
    return corners


def _spread(places: FloatArray, normals: FloatArray) -> FloatArray:
    """Spread the normals on the nodes around them, shape (3, g, g, g)."""
    corners = _corner_weights(places)
    nodes = np.concatenate([nodes for nodes, _ in corners])
    field = [
        np.bincount(
            nodes, np.concatenate([weights * component for _, weights in corners]), _NODES**3
        )
        for component in normals.T
    ]
    spread: FloatArray = np.stack(field).reshape(3, _NODES, _NODES, _NODES)
    return spread


def _integrate(field: FloatArray, smoothing: float) -> FloatArray:
    """Return the function whose gradient is nearest to the field smeared by `smoothing` steps."""
    from scipy import fft  # a heavy module: only the default method needs it

    full = 2.0 * np.pi * np.fft.fftfreq(_NODES)
    half = 2.0 * np.pi * np.fft.rfftfreq(_NODES)
    waves = (full[:, None, None], full[None, :, None], half[None, None, :])
    square = waves[0] ** 2 + waves[1] ** 2 + waves[2] ** 2
    square[0, 0, 0] = 1.0
    total = np.zeros(square.shape, np.complex128)
    for wave, component in zip(waves, field, strict=True):
        total += wave * fft.rfftn(component)
    total *= -1j * np.exp(-0.5 * smoothing**2 * square) / square
    total[0, 0, 0] = 0.0
    chi: FloatArray = fft.irfftn(total, s=(_NODES,) * 3, overwrite_x=True)
    return chi


def sample_grid(values: FloatArray, places: FloatArray) -> FloatArray:
    """Interpolate a grid trilinearly.

    Parameters
    ----------
    values : ndarray of float64, shape (128, 128, 128)
    places : ndarray of float64, shape (n, 3)
        In grid steps from node (0, 0, 0).

    Returns
    -------
    ndarray of float64, shape (n,)
    """
    flat = values.reshape(-1)
    total = np.zeros(len(places))
    for nodes, weights in _corner_weights(places):
        total += weights * flat[nodes]
    return total
