"""How far away a scanner saw something, from one place, in bins of directions."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import Float32Array, FloatArray, IntArray

_PER_BIN = 4.0  # points of a scan that has as many in every direction
_FINEST = 1 << 10  # bins from pole to pole, at most


class DepthSphere:
    """How far away a scanner saw something.

    Parameters
    ----------
    place : ndarray of float64, shape (3,)
    points : int
        About how many will be added: bins hold four of them where they are even.
    """

    def __init__(self, place: FloatArray, points: int) -> None:
        width = np.sqrt(4.0 * np.pi * _PER_BIN / max(points, 1))
        self._height = int(np.clip(np.pi / width, 8, _FINEST))
        self.place = place
        self.nearest: Float32Array = np.full(2 * self._height**2, np.inf, np.float32)
        """By bin, elevations from the lower pole, azimuths within; infinity where nothing was."""

    @property
    def width(self) -> float:
        """Of a bin, in radians."""
        return float(np.pi / self._height)

    def add(self, positions: FloatArray) -> None:
        """Add what it saw, (n, 3)."""
        distances, bins = self.find(positions)
        np.minimum.at(self.nearest, bins, distances.astype(np.float32))

    def find_least(self) -> Float32Array:
        """Return the nearest of each bin and the eight around it, (b,); 0 where one saw nothing."""
        least: Float32Array = self._look_around().min(axis=(2, 3)).reshape(-1)
        return least

    def list_around(self, bins: IntArray) -> Float32Array:
        """Return the nearest of some bins and of the eight around each, (b, 9); 0 for nothing."""
        row, column = np.divmod(bins, 2 * self._height)
        return self._look_around()[row, column].reshape(-1, 9)

    def _look_around(self) -> Float32Array:
        seen = np.where(np.isinf(self.nearest), np.float32(0.0), self.nearest)
        image = seen.reshape(self._height, 2 * self._height)
        # (h + 2, 2 h + 2): azimuths go on around, and beyond the poles nothing was seen.
        padded = np.pad(np.pad(image, ((0, 0), (1, 1)), "wrap"), ((1, 1), (0, 0)))
        return np.lib.stride_tricks.sliding_window_view(padded, (3, 3))

    def list_neighbours(self) -> IntArray:
        """Return pairs of bins that touch, (p, 2), to the right and upwards."""
        number = np.arange(len(self.nearest)).reshape(self._height, -1)
        aside = np.stack([number, np.roll(number, -1, axis=1)], axis=-1).reshape(-1, 2)
        upwards = np.stack([number[:-1], number[1:]], axis=-1).reshape(-1, 2)
        return np.concatenate([aside, upwards])

    def list_places(self, bins: IntArray) -> FloatArray:
        """Return where the nearest of some bins lie, (b, 3), each in the middle of its bin."""
        row, column = np.divmod(bins, 2 * self._height)
        elevations = ((row + 0.5) / self._height - 0.5) * np.pi
        azimuths = ((column + 0.5) / self._height - 1.0) * np.pi
        flat = np.cos(elevations)
        rays = np.stack([flat * np.cos(azimuths), flat * np.sin(azimuths), np.sin(elevations)])
        places: FloatArray = self.place + (self.nearest[bins] * rays).T
        return places

    def find(self, positions: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return how far away points (n, 3) are, and in which bins."""
        height, width = self._height, 2 * self._height
        rays = positions - self.place
        distances: FloatArray = np.sqrt(np.einsum("ni,ni->n", rays, rays))
        heights = rays[:, 2] / np.maximum(distances, 1e-300)
        elevations = np.arcsin(np.clip(heights, -1.0, 1.0)) / np.pi + 0.5
        azimuths = np.arctan2(rays[:, 1], rays[:, 0]) / (2.0 * np.pi) + 0.5
        row = np.minimum((elevations * height).astype(np.int64), height - 1)
        return distances, row * width + np.minimum((azimuths * width).astype(np.int64), width - 1)
