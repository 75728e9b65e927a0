"""Arrays as a page holds them: small, and quick to read.

::

    rows ─> differences ─> 0, -1, 1, -2 as 0, 1, 2, 3 ─> plane of each byte ─> gzip ─> base64

Neighbouring vertices and corners of faces are near each other, so that most differences are small
and all but the lowest planes are zeros. ``static/page.js`` goes the way back.
"""

from __future__ import annotations

import base64
import gzip

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass

Packable = NDArray[np.uint8 | np.uint16 | np.uint32]

_LARGEST = 65535
_LEVEL = 5  # of gzip: a million triangles in half a second


def quantise(positions: FloatArray, low: FloatArray, high: FloatArray) -> NDArray[np.uint16]:
    """Return finite positions (n, 3) in a box as multiples of 1/65535 of its longest side.

    Examples
    --------
    >>> quantise(np.array([[0.0, 1.0, 2.0]]), np.zeros(3), np.full(3, 2.0)).tolist()
    [[0, 32768, 65535]]
    """
    scale = _LARGEST / (float((high - low).max()) or 1.0)
    return np.clip(np.rint((positions - low) * scale), 0, _LARGEST).astype(np.uint16)


@dataclass(frozen=True, slots=True)
class PackedArray:
    """An array as an element of a page has it: its ``id``, its attributes and its text."""

    name: str
    type: str
    rows: int
    columns: int
    packed: str


def pack_array(name: str, values: Packable) -> PackedArray:
    """Pack an array, (n,) or (n, c); the same one gives the same text."""
    rows = np.ascontiguousarray(values)
    columns = 1 if rows.ndim == 1 else rows.shape[1]
    bits = 8 * rows.itemsize
    along = rows.reshape(-1, columns).T
    steps = np.diff(along, axis=1, prepend=along.dtype.type(0))  # modulo 2^bits
    signed = steps.view(np.dtype(f"i{rows.itemsize}"))
    folded = (steps << 1) ^ (signed >> (bits - 1)).view(steps.dtype)
    planes = folded.reshape(-1, 1).astype(f"<u{rows.itemsize}").view(np.uint8).T
    return PackedArray(name, f"u{rows.itemsize}", len(rows), columns, _pack(planes.tobytes()))


def pack_text(text: str) -> str:
    """Return a text as `window.unpack` of a page reads it."""
    return _pack(text.encode())


def _pack(content: bytes) -> str:
    return base64.b64encode(gzip.compress(content, _LEVEL, mtime=0)).decode("ascii")
