"""Colours that PCL packs into one number of four bytes: 0xAARRGGBB, as uint32 or float32."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import ByteArray, FloatArray
from hpcapp.io.columns import Numbers

PACKED = (("red", 2), ("green", 1), ("blue", 0))
"""The colours and which bytes of the number they are, counted from its lowest."""


def unpack_words(words: Numbers, byte: int) -> ByteArray:
    """Return one byte, from the lowest, of each number of four of any type and byte order."""
    little = np.ascontiguousarray(words.astype(words.dtype.newbyteorder("<")))
    return little.view(np.uint8).reshape(-1, 4)[:, byte]


def unpack_float_text(numbers: FloatArray, byte: int) -> ByteArray:
    """Return one byte, counted from the lowest, of packed numbers (n,) that stood in a text.

    Each is the float32 as it is, or the whole number that its bits make.
    """
    is_whole = (numbers >= 1) & (numbers < 2**32) & (numbers == np.rint(numbers))
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        as_floats = numbers.astype("<f4").view("<u4")
        as_whole = np.where(is_whole, numbers, 0).astype("<u4")
    return unpack_words(np.where(is_whole, as_whole, as_floats), byte)
