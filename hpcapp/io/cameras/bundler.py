"""Bundler's bundle.out: a focal length, a rotation and a translation from world to camera.

The names of the pictures are in list.txt beside it, one at the beginning of each line.

https://www.cs.cornell.edu/~snavely/bundler/bundler-v0.3-manual.html
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcapp.io.cameras.lens import Lens
from hpcapp.io.cameras.poses import BACKWARDS, Camera, world_to_camera

_NUMBERS = 15  # of a camera: f, k1, k2; three rows of R; t
_LONGEST_LINE = 1 << 16
_NAMES = "list.txt"


def read_bundle(path: Path, encoding: str) -> list[Camera]:
    """Read the cameras, those left out that were not registered: their numbers are all zero.

    Raise ValueError where the file is cut, or has words where numbers belong.
    """
    with path.open(encoding=encoding, errors="replace") as file:
        title = file.readline(_LONGEST_LINE).split()
        if title[3:4] != ["v0.3"]:
            raise ValueError(f"it is of version {' '.join(title[3:])[:40]!r}, and v0.3 is read")
        counts = file.readline(_LONGEST_LINE).split()
        count = int(counts[0]) if counts else 0
        if not 0 <= 2 * _NUMBERS * count <= path.stat().st_size:
            raise ValueError(f"it claims {count} cameras, and has {path.stat().st_size} bytes")
        words: list[str] = []
        while len(words) < _NUMBERS * count and (line := file.readline(_LONGEST_LINE)):
            words += line.split()
    if len(words) < _NUMBERS * count:
        raise ValueError(f"it ends after {len(words) // _NUMBERS} of {count} cameras")
    rows = np.array([float(word) for word in words[: _NUMBERS * count]]).reshape(-1, _NUMBERS)
    is_known = rows.any(axis=1)
    names = np.array(_read_names(path, count), object)[is_known].tolist()
    rows = rows[is_known]
    lenses = [Lens((0.0, 0.0), (f, f), radial=(k1, k2)) if f > 0.0 else None
              for f, k1, k2 in rows[:, :3].tolist()]  # fmt: skip
    return world_to_camera(rows[:, 3:12], rows[:, 12:], BACKWARDS, names, lenses)


def _read_names(path: Path, count: int) -> list[str]:
    """Return the names of so many pictures, empty where no file has them."""
    beside = path.with_name(_NAMES)
    if not beside.is_file():
        return [""] * count
    with beside.open(encoding="utf-8", errors="replace") as file:
        return [file.readline(_LONGEST_LINE).split(" ")[0].strip() for _ in range(count)]
