"""COLMAP's images.txt and images.bin: a quaternion and a translation from world to camera.

https://colmap.github.io/format.html
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import TextIO

from hpcapp.io.cameras.colmap_lenses import read_lenses
from hpcapp.io.cameras.poses import FORWARDS, Camera, quaternion_matrices, world_to_camera

_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_IMAGE = re.compile(rf"\s*\d+\s+((?:{_NUMBER}\s+){{7}})(\d+)\s+(\S[^\r\n]*)", re.ASCII)
_FIRST_NUMBER = rf"{_NUMBER}(?:\s|$)"
_TITLE = "IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ"
_PARTS = {"# Camera list": "cameras.txt", "# 3D point list": "points3D.txt"}
_PARTS |= {"# Rig ": "rigs.txt", "# Frame list": "frames.txt"}
_LONGEST_LINE = 1 << 16  # characters of an image; those of its points are passed over
_AT_ONCE = 1 << 20
_COUNT = struct.Struct("<Q")
_POSE = struct.Struct("<I7dI")  # image, quaternion, translation, camera
_LONGEST_NAME = 4096
_KEYPOINT = 24  # bytes
_LEAST = _POSE.size + 1 + _COUNT.size  # bytes of an image without a name and points


def has_images(head: str) -> bool:
    """Tell whether a text begins as images.txt does."""
    rows = [line for line in head.splitlines() if line.strip() and not line.startswith("#")]
    found = _IMAGE.match(rows[0]) if rows else None
    return _TITLE in head or (found is not None and not re.match(_FIRST_NUMBER, found[3]))


def find_colmap_part(head: str) -> str | None:
    """Return which of COLMAP's other files a text is; None where it is none."""
    return next((name for title, name in _PARTS.items() if head.startswith(title)), None)


def read_images_text(path: Path, encoding: str) -> list[Camera]:
    """Read the cameras of images.txt: a line for an image, then one for its points, or empty.

    Raise ValueError where a line is neither.
    """
    numbers: list[list[float]] = []
    pictures: list[tuple[int, str]] = []
    with path.open(encoding=encoding, errors="replace") as file:
        while line := file.readline(_LONGEST_LINE):
            line = line.removeprefix("\ufeff")
            if not line.strip() or line.startswith("#"):
                continue
            found = _IMAGE.match(line)
            if not found or len(line) == _LONGEST_LINE:
                raise ValueError(f"no line of an image: {line.strip()[:60]!r}")
            numbers.append([float(word) for word in found[1].split()])
            pictures.append((int(found[2]), found[3].rstrip()))
            if (last := _pass_line(file)) and not re.fullmatch(r"-?\d+", last, re.ASCII):
                raise ValueError(
                    f"the line after image {len(numbers)} is not that of its points (it may be "
                    f"empty, but not missing): it ends in {last[-60:]!r}"
                )
    return _place(path, numbers, pictures)


def read_images_binary(path: Path) -> list[Camera]:
    """Read the cameras of images.bin; raise ValueError where it is cut, or something else."""
    size, place = path.stat().st_size, _COUNT.size
    numbers: list[tuple[float, ...]] = []
    pictures: list[tuple[int, str]] = []
    with path.open("rb") as file:
        head = file.read(place)
        count = _COUNT.unpack(head)[0] if len(head) == place else 0
        if count > (size - place) // _LEAST:
            raise ValueError(f"it claims {count} images, and has {size} bytes")
        for image in range(1, count + 1):
            file.seek(place)
            head = file.read(_POSE.size + _LONGEST_NAME + _COUNT.size)
            end = head.find(b"\0", _POSE.size) + 1
            if not 0 < end <= len(head) - _COUNT.size:
                raise ValueError(f"image {image} has no name that ends, or the file is cut there")
            _, *pose, lens = _POSE.unpack_from(head)
            numbers.append(tuple(pose))
            pictures.append((lens, head[_POSE.size : end - 1].decode("utf-8", "replace")))
            keypoints = _COUNT.unpack_from(head, end)[0]
            place += end + _COUNT.size
            if keypoints > (size - place) // _KEYPOINT:
                raise ValueError(f"image {image} claims {keypoints} points; the file is cut there")
            place += keypoints * _KEYPOINT
    if place != size:
        raise ValueError(f"{count} images end at byte {place} of {size}")
    return _place(path, numbers, pictures)


def _pass_line(file: TextIO) -> str:
    """Read a line of any length, and return its last word."""
    last = ""
    while part := file.readline(_AT_ONCE):
        last = (last + part)[-_LONGEST_LINE:]
        if part.endswith("\n"):
            break
    words = last.split()
    return words[-1] if words else ""


def _place(
    path: Path,
    numbers: list[list[float]] | list[tuple[float, ...]],
    pictures: list[tuple[int, str]],
) -> list[Camera]:
    """Return the cameras of poses, and of the numbers of lenses and the names of pictures."""
    rotations = quaternion_matrices([row[:4] for row in numbers])
    lenses = read_lenses(path.parent)
    return world_to_camera(
        rotations, [row[4:] for row in numbers], FORWARDS,
        [name for _, name in pictures], [lenses.get(number) for number, _ in pictures],
    )  # fmt: skip
