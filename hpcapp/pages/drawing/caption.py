"""Lines of text in the upper left corner of a picture, each behind a patch of a colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_INK, _HALO = (40, 44, 52), (255, 255, 255)
_LEAST = 11.0  # pixels of a letter

Colour = tuple[int, int, int]


def add_caption(
    picture: NDArray[np.uint8], lines: Sequence[tuple[Colour | None, str]]
) -> NDArray[np.uint8]:
    """Return a picture with lines of text in its upper left corner.

    A patch of its colour stands before the text; None is no patch.
    """
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(picture)
    pen = ImageDraw.Draw(image)
    size = round(max(0.02 * max(picture.shape[:2]), _LEAST))
    font = ImageFont.load_default(size)
    for number, (colour, text) in enumerate(lines):
        left, top = 1.2 * size, (1.0 + 1.5 * number) * size
        if colour is not None:
            pen.rectangle([left, top, left + 0.8 * size, top + 0.8 * size], fill=colour)
        pen.text(
            (left + 1.2 * size, top - 0.1 * size), text, fill=_INK, font=font,
            stroke_width=max(1, size // 8), stroke_fill=_HALO,
        )  # fmt: skip
    return np.asarray(image)
