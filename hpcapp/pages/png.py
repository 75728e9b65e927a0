"""Pictures as PNG files."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.io.staging import replacing

__all__ = ["encode_png", "write_png"]


def write_png(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write a picture as PNG, which appears whole or not at all.

    Parameters
    ----------
    picture : ndarray of uint8, shape (height, width, 3)

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    content = encode_png(picture)
    with replacing(path) as file:
        file.write(content)


def encode_png(picture: NDArray[np.uint8]) -> bytes:
    """Return a picture as the bytes of a PNG file; see `write_png`."""
    height, width = picture.shape[:2]
    # Each row of a PNG begins with the number of its filter: 0 is none.
    rows = np.insert(picture.reshape(height, 3 * width), 0, 0, axis=1)
    head = struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)  # 8 bits of red, green and blue
    packed = zlib.compress(rows.tobytes())
    encoded = b"\x89PNG\r\n\x1a\n"
    for name, content in ((b"IHDR", head), (b"IDAT", packed), (b"IEND", b"")):
        checked = name + content
        encoded += struct.pack(">I", len(content)) + checked
        encoded += struct.pack(">I", zlib.crc32(checked))
    return encoded
