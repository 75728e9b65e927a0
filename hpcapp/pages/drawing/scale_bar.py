"""A bar in a picture that says how long a round length is."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_SHARE = 0.25  # of the picture's width, at most
_LEAST = 120  # pixels of a side, below which a picture has no room for it
_INK = (40, 44, 52)
_HALO = (255, 255, 255)
_METRIC = (("km", 1e3), ("m", 1.0), ("cm", 1e-2), ("mm", 1e-3))
_METRES = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3}


def choose_length(pixels_per_unit: float, width: int) -> float:
    """Return a length of 1, 2 or 5 times a power of ten that takes a quarter of a picture at most.

    Examples
    --------
    >>> choose_length(100.0, 800)
    2.0
    """
    longest = _SHARE * width / pixels_per_unit
    power: float = 10.0 ** math.floor(math.log10(longest))
    digit = max(digit for digit in (1, 2, 5) if digit * power <= longest * (1 + 1e-9))
    return float(f"{digit * power:.3g}")


def name_length(length: float, unit: str | None) -> str:
    """Return a length as people say it, in a unit that may not be known.

    Examples
    --------
    >>> name_length(0.02, "m"), name_length(2000.0, "m"), name_length(50.0, "ft")
    ('2 cm', '2 km', '50 ft')
    >>> name_length(0.5, None), name_length(1.0, None)
    ('0.5 units', '1 unit')
    """
    if unit in _METRES:
        metres = length * _METRES[unit]
        unit, size = next((pair for pair in _METRIC if metres >= 0.999 * pair[1]), _METRIC[-1])
        length = metres / size
    text = f"{length:,.0f}" if 1e3 <= length < 1e9 else f"{length:.3g}"
    return f"{text} {unit or ('unit' if length == 1.0 else 'units')}"


def add_scale_bar(
    picture: NDArray[np.uint8], pixels_per_unit: float, unit: str | None
) -> NDArray[np.uint8]:
    """Return a picture with a bar in its lower left corner; a very small one as it is."""
    from PIL import Image, ImageDraw, ImageFont

    height, width = picture.shape[:2]
    if min(height, width) < _LEAST or not 1e-300 < pixels_per_unit < 1e300:
        return picture
    length = choose_length(pixels_per_unit, width)
    text = name_length(length, unit)
    image = Image.fromarray(picture)
    pen = ImageDraw.Draw(image)
    size = round(min(max(0.02 * max(height, width), 11.0), 0.08 * min(height, width)))
    left, bottom = 1.2 * size, height - 1.2 * size
    right = left + length * pixels_per_unit
    tick, line = 0.35 * size, max(1, size // 8)
    for colour, extra in ((_HALO, 2 * line), (_INK, 0)):
        for begin, end in (
            ((left, bottom), (right, bottom)),
            ((left, bottom - tick), (left, bottom + tick)),
            ((right, bottom - tick), (right, bottom + tick)),
        ):
            pen.line([begin, end], fill=colour, width=line + extra)
    pen.text(
        (0.5 * (left + right), bottom - 0.5 * size),
        text,
        fill=_INK,
        anchor="ms",
        font=ImageFont.load_default(size),
        stroke_width=line,
        stroke_fill=_HALO,
    )
    return np.asarray(image)
