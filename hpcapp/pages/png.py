"""Pictures as PNG files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.io.staging import replacing

__all__ = ["write_png"]


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
    from PIL import Image

    with replacing(path) as file:
        Image.fromarray(picture).save(file, "PNG", optimize=True)
