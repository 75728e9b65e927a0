"""A cloth that falls on a scan turned upside down: its surface is the bare ground.

By the library of the method's authors, in a process of its own: it prints whatever it does, and
cannot be interrupted. One thread of it, as several do not give the same numbers twice.

References
----------
W. Zhang and others, An easy-to-use airborne LiDAR data filtering method based on cloth simulation,
Remote Sensing 8 (6), 2016, https://doi.org/10.3390/rs8060501
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from hpcapp.extras import require_library
from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError
from hpccomponent.files.held_folders import temporary_folder, temporary_room

STEP = 0.5
"""Metres between the threads of the cloth: the authors' for all of their fifteen scans."""

MOST_CROSSINGS = 1 << 23
"""Of the threads: some 2 square kilometres; 450 bytes each, and a minute for 4 million."""

_RIGIDNESS = 2  # of 1 to 3: for relief, as the authors'
_POINTS, _HEIGHTS = "points.npy", "cloth.npy"


@dataclass(frozen=True, slots=True, eq=False)
class Cloth:
    """The ground as heights (h, w), in metres: a row for each y from the corner x, y on."""

    corner: FloatArray
    heights: FloatArray

    def evaluate(self, places: FloatArray) -> FloatArray:
        """Return the heights at places of shape (n, 2)."""
        rows, columns = self.heights.shape
        at = np.clip((places - self.corner) / STEP, 0.0, (columns - 1.000001, rows - 1.000001))
        x, y = np.floor(at).astype(np.int64).T
        u, v = (at - np.floor(at)).T
        below = (1 - u) * self.heights[y, x] + u * self.heights[y, x + 1]
        above = (1 - u) * self.heights[y + 1, x] + u * self.heights[y + 1, x + 1]
        heights: FloatArray = (1 - v) * below + v * above
        return heights


def drape(points: FloatArray, name: str) -> Cloth:
    """Let a cloth fall on points (n, 3), in metres; the lowest of each of its squares are enough.

    Raise MissingLibraryError without the library, and InputError where the scan is too large.
    """
    require_library(
        "CSF",
        f"{name}: its points have no class 2; to find the ground among them needs the package "
        "cloth-simulation-filter",
        "ground",
    )
    crossings = np.prod(np.ptp(points[:, :2], axis=0) / STEP + 5.0)
    if crossings > MOST_CROSSINGS:
        raise InputError(
            f"{name}: too large to find the ground by a cloth: {crossings * STEP**2 / 1e6:.3g} "
            f"square kilometres, of {MOST_CROSSINGS * STEP**2 / 1e6:.3g} that fit",
            "cut it by --box or --polygon, or have the file classified: class 2 has no limit",
        )
    low = points.min(axis=0)
    with temporary_folder() as folder:
        with temporary_room():
            np.save(folder / _POINTS, points - low)
        command = [sys.executable, "-P", "-c", f"from {__name__} import main; main()"]
        paths = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
        process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
            [*command, str(folder)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1"},
        )
        try:
            process.wait()
        finally:
            process.kill()
            process.wait()
        if process.returncode:
            raise InputError(
                f"{name}: the cloth simulation ended by {-process.returncode or 'an error'}",
                "is memory short? cut the scan by --box or --polygon",
            )
        nodes = np.load(folder / _HEIGHTS)
    width = int((nodes[:, 1] == nodes[0, 1]).sum())
    return Cloth(nodes[0, :2] + low[:2], nodes[:, 2].reshape(-1, width) + low[2])


def main() -> None:
    """Do it in the process of its own, given the folder."""
    import CSF

    folder = Path(sys.argv[1])
    cloth = CSF.CSF()
    cloth.params.bSloopSmooth = True
    cloth.params.cloth_resolution = STEP
    cloth.params.rigidness = _RIGIDNESS
    cloth.setPointCloud(np.load(folder / _POINTS))
    np.save(folder / _HEIGHTS, np.array(cloth.do_cloth_export()).reshape(-1, 3))
