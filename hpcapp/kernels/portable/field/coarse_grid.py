"""A coarse cubic grid: spreading, integrating and interpolating."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.lattice import unpack_keys
from hpcapp.geometry.points import Float32Array, FloatArray, IntArray

__all__ = ["integrate_normals", "sample_corners", "sample_grid"]

Held = tuple[slice, slice]
Spectrum = NDArray[np.complex64] | NDArray[np.complex128]  # numpy 1 transforms in double precision


def _corner_weights(places: FloatArray, nodes: int) -> list[tuple[IntArray, FloatArray]]:
    """Return the flat index and the trilinear weight of the eight nodes around each place."""
    lower = np.clip(np.floor(places).astype(np.int64), 0, nodes - 2)
    local = places - lower
    corners = []
    for octant in range(8):
        bits = [octant >> axis & 1 for axis in range(3)]
        factors = [local[:, a] if bit else 1.0 - local[:, a] for a, bit in enumerate(bits)]
        x, y, z = (lower[:, a] + bit for a, bit in enumerate(bits))
        corners.append(((x * nodes + y) * nodes + z, factors[0] * factors[1] * factors[2]))
    return corners


def integrate_normals(
    places: FloatArray,
    normals: FloatArray,
    smoothing: float,
    held: IntArray,
    nodes: int,
    threads: int = 1,
) -> Float32Array:
    """Integrate normals (n, 3), spread on a periodic grid and smeared by a Gaussian.

    `places` (n, 3) are in grid steps from node (0, 0, 0), as is the standard deviation of the
    Gaussian, `smoothing`; the grid has `nodes` along each side, a power of two. `held` (2, 2) has
    the first and the end of the planes (x) and of the rows (y) to be kept; all samples must lie
    between them. Return the function (planes, rows, nodes) whose gradient is nearest to the smeared
    normals, times grid steps.

    Notes
    -----
    chi^ = -i k . V^ / k^2 for the vector field V. The transforms run axis by axis in single
    precision, so that rows without a sample are skipped and sums share them.
    """
    del threads  # numpy runs on one
    kept = slice(*held[0]), slice(*held[1])
    full = (2.0 * np.pi * np.fft.fftfreq(nodes)).astype(np.float32)
    kx, ky, kz = full[:, None, None], full[None, :, None], full[None, None, : nodes // 2]
    # Three of (planes, nodes, nodes / 2): each component's spectrum along z.
    rows = [_transform_rows(places, normals[:, axis], nodes, kept) for axis in range(3)]
    # (nodes, nodes, nodes / 2): k . V^, of which y and z share the transform along x.
    total: Spectrum = ky * np.fft.fft(rows[1], axis=1) + np.fft.fft(kz * rows[2], axis=1)
    total = np.fft.fft(_pad_planes(total, nodes, kept), axis=0)
    total += kx * np.fft.fft(_pad_planes(np.fft.fft(rows[0], axis=1), nodes, kept), axis=0)
    square = kx**2 + ky**2 + kz**2
    square[0, 0, 0] = 1.0  # the mean, which no gradient tells: it is set to 0 below
    total *= np.exp(np.float32(-0.5 * smoothing**2) * square) / square
    total *= np.complex64(-1j)
    total[0, 0, 0] = 0.0
    # Back axis by axis; what lies outside of the kept planes and rows is not transformed.
    total = np.fft.ifft(total, axis=0)[kept[0]]
    total = np.fft.ifft(total, axis=1)[:, kept[1]]
    return np.fft.irfft(total, nodes, axis=2).astype(np.float32, copy=False)


def _transform_rows(places: FloatArray, component: FloatArray, nodes: int, kept: Held) -> Spectrum:
    """Spread one component and transform it along z, within the planes that hold samples.

    Half a turn a node, the highest frequency, has no slope and is left out.
    """
    corners = _corner_weights(places, nodes)
    # (8 n,): each sample adds to the eight nodes around it.
    where = np.concatenate([node for node, _ in corners])
    values = np.concatenate([weights * component for _, weights in corners])
    grid = np.bincount(where, values, nodes**3).astype(np.float32).reshape((nodes,) * 3)[kept]
    rows = np.zeros((grid.shape[0], nodes, nodes // 2), np.complex64)
    rows[:, kept[1]] = np.fft.rfft(grid, axis=2)[:, :, :-1]
    return rows


def _pad_planes(planes: Spectrum, nodes: int, kept: Held) -> Spectrum:
    """Put the planes that hold samples between those that hold none."""
    padded = np.zeros((nodes, *planes.shape[1:]), np.complex64)
    padded[kept[0]] = planes
    return padded


def sample_grid(values: Float32Array, places: FloatArray) -> FloatArray:
    """Interpolate a grid (g, g, g) trilinearly at places (n, 3), which gives (n,).

    Places are in grid steps from node (0, 0, 0); beyond the grid its outermost cells are continued.
    """
    flat = values.reshape(-1)
    total = np.zeros(len(places))
    for nodes, weights in _corner_weights(places, len(values)):
        total += weights * flat[nodes]
    return total


def sample_corners(
    values: Float32Array, keys: IntArray, origin: FloatArray, spacing: float
) -> FloatArray:
    """Interpolate a grid (g, g, g) trilinearly at the corners of a lattice, sorted keys (v,).

    In grid steps, `origin` (3,) is corner (0, 0, 0) seen from node (0, 0, 0), and `spacing` that of
    the corners. Return values (v,).
    """
    return sample_grid(values, origin + spacing * unpack_keys(keys))
