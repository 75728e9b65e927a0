"""Bundler's bundle.out: a focal length, a rotation and a translation from world to camera.

https://www.cs.cornell.edu/~snavely/bundler/bundler-v0.3-manual.html
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.cameras.poses import BACKWARDS, world_to_camera

_NUMBERS = 15  # of a camera: f, k1, k2; three rows of R; t
_LONGEST_LINE = 1 << 16


def read_bundle(path: Path, encoding: str) -> FloatArray:
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
    rows = rows[rows.any(axis=1)]
    return world_to_camera(rows[:, 3:12], rows[:, 12:], BACKWARDS)
