"""A coarse signed distance everywhere: the sign in empty space, and what closes holes.

The normals of the cells, spread on a coarse periodic grid, are the gradient of an indicator
function; one Poisson equation, solved by FFT, gives it. Near the samples it is scaled to a signed
distance, and it is cut off one and a half grid steps from the surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.points import FloatArray

__all__ = ["FarField", "far_step", "solve_far_field"]

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
        In length units of the input, positive outside, at most 1.5 steps large; 0 far from the
        box that the field was asked to cover.
    origin : ndarray of float64, shape (3,)
        Where node (0, 0, 0) lies.
    step : float
        Distance of neighbouring nodes, in length units of the input.
    """

    values: Float32Array
    origin: FloatArray
    step: float


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
    return _PADDING * float((high - low).max()) / _NODES


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
    step = far_step(low, high)
    origin = 0.5 * (low + high) - 0.5 * step * _NODES
    places = (centroids - origin) / step
    held = _held_rows((low - origin) / step, (high - origin) / step)
    chi = _integrate(places, normals, max(1.0, smoothing / step), held)
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    chi -= np.float32(sample_grid(chi, places).mean())
    rise = sample_grid(chi, places + unit) - sample_grid(chi, places - unit)
    slope = max(float(rise.mean()) / (2.0 * step), 1e-300)
    chi /= np.float32(slope)
    np.clip(chi, -_REACH * step, _REACH * step, out=chi)
    return FarField(chi, origin, step)


def _integrate(
    places: FloatArray, normals: FloatArray, smoothing: float, held: tuple[slice, slice]
) -> Float32Array:
    """Return the function whose gradient is nearest to the normals smeared by `smoothing` steps.

    Only between the planes and rows `held`, and 0 elsewhere; all samples lie between them.
    In single precision and one component after the other: the grids are most of the memory. The
    transforms run axis by axis, so that rows without a sample are skipped and sums share them.
    """
    full = (2.0 * np.pi * np.fft.fftfreq(_NODES)).astype(np.float32)
    half = (2.0 * np.pi * np.fft.rfftfreq(_NODES)).astype(np.float32)
    kx, ky, kz = full[:, None, None], full[None, :, None], half[None, None, :]
    total: NDArray[Any] = _transform_rows(places, normals, 2, held)
    total *= kz
    total = np.fft.fft(total, axis=1)
    total += ky * np.fft.fft(_transform_rows(places, normals, 1, held), axis=1)
    total = np.fft.fft(_pad_planes(total, held), axis=0)
    first = np.fft.fft(_transform_rows(places, normals, 0, held), axis=1)
    total += kx * np.fft.fft(_pad_planes(first, held), axis=0)
    square = kx**2 + ky**2 + kz**2
    square[0, 0, 0] = 1.0
    total *= np.exp(np.float32(-0.5 * smoothing**2) * square) / square
    total *= np.complex64(-1j)
    total[0, 0, 0] = 0.0
    total = np.fft.ifft(total, axis=0)[held[0]]
    total = np.fft.ifft(total, axis=1)[:, held[1]]
    chi = np.zeros((_NODES,) * 3, np.float32)
    chi[held] = np.fft.irfft(total, _NODES, axis=2)
    return chi


def _held_rows(low: FloatArray, high: FloatArray) -> tuple[slice, slice]:
    """Return the planes and the rows of the grid that a box and two nodes around it take up."""
    first = np.maximum(np.floor(low).astype(int) - 2, 0)
    last = np.minimum(np.ceil(high).astype(int) + 3, _NODES)
    return slice(first[0], last[0]), slice(first[1], last[1])


def _transform_rows(
    places: FloatArray, normals: FloatArray, axis: int, held: tuple[slice, slice]
) -> NDArray[Any]:
    """Transform one component along z, within the planes that hold samples."""
    from hpccomponent.surface.kernels import spread_component  # which knows fields

    grid = spread_component(places, normals, axis, _NODES)[held]
    rows = np.zeros((grid.shape[0], _NODES, _NODES // 2 + 1), np.complex64)
    rows[:, held[1]] = np.fft.rfft(grid, axis=2)
    return rows


def _pad_planes(planes: NDArray[Any], held: tuple[slice, slice]) -> NDArray[Any]:
    """Put the planes that hold samples between those that hold none."""
    padded = np.zeros((_NODES, *planes.shape[1:]), np.complex64)
    padded[held[0]] = planes
    return padded
