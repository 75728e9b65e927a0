"""Pictures as PNG files."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.io.staging import replacing


def write_png(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write a picture (height, width, 3) as PNG, which appears whole or not at all.

    Raise OutputError where the file cannot be written.
    """
    content = encode_png(picture)
    with replacing(path) as file:
        file.write(content)


def encode_png(picture: NDArray[np.uint8]) -> bytes:
    """Return a picture as the bytes of a PNG file; see `write_png`."""
    from PIL import Image

    encoded = BytesIO()
    Image.fromarray(picture).save(encoded, "PNG", optimize=True)
    return encoded.getvalue()
