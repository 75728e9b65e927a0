"""A coarse signed distance everywhere: the sign in empty space, and what closes holes.

The normals of the cells, spread on a coarse periodic grid, are the gradient of an indicator
function; one Poisson equation, solved by FFT, gives it. Near the samples it is scaled to a signed
distance, and it is cut off one and a half grid steps from the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.points import FloatArray

__all__ = ["FarField", "solve_far_field"]

_NODES = 128
_PADDING = 1.5
_REACH = 1.5

Float32Array = NDArray[np.float32]


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

    values: Float32Array
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
    from hpccomponent.surface.kernels import sample_grid  # which knows fields, made of these

    low, high = box
    edge = _PADDING * float((high - low).max())
    step = edge / _NODES
    origin = 0.5 * (low + high) - 0.5 * edge
    places = (centroids - origin) / step
    chi = _integrate(places, normals, max(1.0, smoothing / step))
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    chi -= np.float32(sample_grid(chi, places).mean())
    rise = sample_grid(chi, places + unit) - sample_grid(chi, places - unit)
    slope = max(float(rise.mean()) / (2.0 * step), 1e-300)
    chi /= np.float32(slope)
    np.clip(chi, -_REACH * step, _REACH * step, out=chi)
    return FarField(chi, origin, step)


def _integrate(places: FloatArray, normals: FloatArray, smoothing: float) -> Float32Array:
    """Return the function whose gradient is nearest to the normals smeared by `smoothing` steps.

    In single precision and one component after the other: the grids are most of the memory.
    """
    from hpccomponent.surface.kernels import spread_component

    full = (2.0 * np.pi * np.fft.fftfreq(_NODES)).astype(np.float32)
    half = (2.0 * np.pi * np.fft.rfftfreq(_NODES)).astype(np.float32)
    waves = (full[:, None, None], full[None, :, None], half[None, None, :])
    square = waves[0] ** 2 + waves[1] ** 2 + waves[2] ** 2
    square[0, 0, 0] = 1.0
    total = np.zeros(square.shape, np.complex64)
    for axis, wave in enumerate(waves):
        spectrum = np.fft.rfftn(spread_component(places, normals, axis, _NODES))
        spectrum *= wave
        total += spectrum
    total *= np.exp(np.float32(-0.5 * smoothing**2) * square) / square
    total *= np.complex64(-1j)
    total[0, 0, 0] = 0.0
    return np.fft.irfftn(total, s=(_NODES,) * 3, axes=(0, 1, 2)).astype(np.float32, copy=False)
