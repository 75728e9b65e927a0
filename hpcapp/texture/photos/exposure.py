"""How much brighter one photograph is than another, told by what both show."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import ByteArray, FloatArray, IntArray

_LIMITS = 8, 247  # of 255: what is darker or lighter has been cut
_FARTHEST = np.log(4.0)
"""Of two photographs' light: farther apart they show different things. Exposures of one set differ
by 2 stops at most where their light is to be levelled at all."""
_SLACK = 1.0  # texels: what a gain that hangs on nothing is worth


def make_linear() -> FloatArray:
    """Return the light, 0 to 1, of the 256 values of sRGB."""
    values = np.arange(256) / 255.0
    light: FloatArray = np.where(
        values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4
    )
    return light


def to_srgb(light: FloatArray) -> ByteArray:
    """Return the values of light, 0 to 1."""
    kept = np.clip(light, 0.0, 1.0)
    values = np.where(kept <= 0.0031308, 12.92 * kept, 1.055 * kept ** (1.0 / 2.4) - 0.055)
    return np.rint(255.0 * values).astype(np.uint8)


class Exposures:
    """Sums, over texels that two of so many photographs show, of how their light differs."""

    def __init__(self, photos: int) -> None:
        self._photos = photos
        self._sums: dict[int, FloatArray] = {}
        light = make_linear()
        self._logs = np.log(np.maximum(light, light[1]))

    def add(self, one: IntArray, other: IntArray, ones: ByteArray, others: ByteArray) -> None:
        """Add texels by the numbers of the photographs (n,), and what these show (n, 3)."""
        far = self._logs[ones] - self._logs[others]
        low, high = np.minimum(ones, others).min(axis=1), np.maximum(ones, others).max(axis=1)
        counts = (low >= _LIMITS[0]) & (high <= _LIMITS[1]) & (np.abs(far) < _FARTHEST).all(axis=1)
        pairs, rows = np.unique(one[counts] * self._photos + other[counts], return_inverse=True)
        columns = [np.ones(counts.sum()), *far[counts].T]
        totals = np.stack([np.bincount(rows, column, len(pairs)) for column in columns], axis=1)
        for pair, total in zip(pairs.tolist(), totals, strict=True):
            self._sums[pair] = self._sums.get(pair, 0.0) + total

    def solve(self) -> FloatArray:
        """Return by what the light of each photograph is to be multiplied, shape (p, 3).

        Least squares of the logarithms, whose mean is 0 among photographs that hang together.
        """
        from scipy.sparse import coo_array
        from scipy.sparse.linalg import lsqr

        if not self._sums:
            return np.ones((self._photos, 3))
        pairs = np.array(list(self._sums))
        sums = np.stack(list(self._sums.values()))
        roots = np.sqrt(sums[:, 0])
        rows = np.arange(len(pairs))
        system = coo_array((
            np.concatenate([roots, -roots]),
            (np.tile(rows, 2), np.concatenate(np.divmod(pairs, self._photos))),
        ), (len(pairs), self._photos)).tocsr()  # fmt: skip
        logs = [lsqr(system, -channel / roots, damp=_SLACK, atol=1e-9, btol=1e-9)[0]
                for channel in sums[:, 1:].T]  # fmt: skip
        gains: FloatArray = np.exp(np.stack(logs, axis=1))
        return gains
