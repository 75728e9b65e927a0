"""Point clouds written as lines of numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.io.rows import write_rows
from hpcapp.io.staging import replacing
from hpccomponent.surface.types.points import PointCloud

__all__ = ["write_text_points"]


def write_text_points(path: Path, cloud: PointCloud) -> None:
    """Write a point cloud as lines of numbers that `open_text` reads back.

    Parameters
    ----------
    path : Path
        Appears whole or not at all.
    cloud : PointCloud
        Written in the input's frame, to the last digit.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    columns: list[NDArray[np.float64] | NDArray[np.uint8]] = [cloud.positions + cloud.origin]
    if cloud.normals is not None:
        columns.append(cloud.normals)
    elif cloud.colours is not None:
        columns.append(np.zeros((len(cloud), 1), np.uint8))  # an intensity: 6 columns mean normals
    template = " ".join(["%.17g"] * (6 if cloud.normals is not None else 3))
    if cloud.colours is not None:
        columns.append(cloud.colours)
        template += " %d" * (3 if cloud.normals is not None else 4)
    with replacing(path) as file:
        file.writelines(write_rows(template + "\n", np.hstack(columns)))
