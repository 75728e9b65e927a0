"""The lenses of a model of COLMAP: cameras.bin or cameras.txt beside the images.

https://colmap.github.io/cameras.html
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

from hpcapp.io.cameras.lens import Lens

_HEAD = struct.Struct("<IiQQ")  # camera, model, width, height
_COUNT = struct.Struct("<Q")
_LARGEST = 1 << 26  # bytes: a million cameras
_Make = Callable[[tuple[float, float], tuple[float, ...]], Lens]


def _place(
    size: tuple[float, float], fx: float, fy: float, cx: float, cy: float, *more: float,
    is_fisheye: bool = False,
) -> Lens:  # fmt: skip
    """Return a lens whose further numbers are k1, k2, p1, p2, k3, ..; of a fisheye k alone."""
    offset = cx - 0.5 * size[0], cy - 0.5 * size[1]
    if is_fisheye or len(more) < 4:
        return Lens(size, (fx, fy), offset, more, is_fisheye=is_fisheye)
    k1, k2, p1, p2, *k = more
    return Lens(size, (fx, fy), offset, (k1, k2, *k[:1]), tuple(k[1:]), (p1, p2))


def _of_one(size: tuple[float, float], numbers: tuple[float, ...]) -> Lens:
    return _place(size, numbers[0], *numbers)


def _of_two(size: tuple[float, float], numbers: tuple[float, ...]) -> Lens:
    return _place(size, *numbers)


def _fisheye_of_one(size: tuple[float, float], numbers: tuple[float, ...]) -> Lens:
    return _place(size, numbers[0], *numbers, is_fisheye=True)


def _fisheye_of_two(size: tuple[float, float], numbers: tuple[float, ...]) -> Lens:
    return _place(size, *numbers, is_fisheye=True)


_MODELS: tuple[tuple[str, int, _Make | None], ...] = (
    ("SIMPLE_PINHOLE", 3, _of_one),
    ("PINHOLE", 4, _of_two),
    ("SIMPLE_RADIAL", 4, _of_one),
    ("RADIAL", 5, _of_one),
    ("OPENCV", 8, _of_two),
    ("OPENCV_FISHEYE", 8, _fisheye_of_two),
    ("FULL_OPENCV", 12, _of_two),
    ("FOV", 5, None),
    ("SIMPLE_RADIAL_FISHEYE", 4, _fisheye_of_one),
    ("RADIAL_FISHEYE", 5, _fisheye_of_one),
    ("THIN_PRISM_FISHEYE", 12, None),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16, None),
)
"""By their numbers: the name, how many parameters, and what makes a lens of them."""


def read_lenses(folder: Path) -> dict[int, Lens]:
    """Return the lenses of a model by their numbers; none where the files are not there.

    Lenses of other models are left out. Raise ValueError where a file is cut.
    """
    binary, text = folder / "cameras.bin", folder / "cameras.txt"
    if binary.is_file():
        return _read_binary(_read(binary))
    if text.is_file():
        return _read_text(_read(text).decode("utf-8", "replace"))
    return {}


def _read(path: Path) -> bytes:
    if path.stat().st_size > _LARGEST:
        raise ValueError(f"{path.name} beside it has more than {_LARGEST} bytes")
    return path.read_bytes()


def _read_binary(raw: bytes) -> dict[int, Lens]:
    lenses = {}
    try:
        place = _COUNT.size
        for _ in range(_COUNT.unpack_from(raw)[0]):
            number, model, width, height = _HEAD.unpack_from(raw, place)
            if not 0 <= model < len(_MODELS):
                raise ValueError(f"cameras.bin beside it has a camera of the model {model}")
            _, count, make = _MODELS[model]
            numbers = struct.unpack_from(f"<{count}d", raw, place + _HEAD.size)
            place += _HEAD.size + 8 * count
            if make is not None:
                lenses[number] = make((float(width), float(height)), numbers)
    except struct.error:
        raise ValueError("cameras.bin beside it is cut") from None
    return lenses


def _read_text(text: str) -> dict[int, Lens]:
    known = {name: (count, make) for name, count, make in _MODELS}
    lenses = {}
    for line in text.splitlines():
        words = line.split()
        if not words or line.startswith("#"):
            continue
        count, make = known.get("".join(words[1:2]), (0, None))
        if make is None:
            continue
        if len(words) < 4 + count:
            raise ValueError(f"cameras.txt beside it has no camera: {line.strip()[:60]!r}")
        width, height, *numbers = (float(word) for word in words[2 : 4 + count])
        lenses[int(words[0])] = make((width, height), tuple(numbers))
    return lenses
