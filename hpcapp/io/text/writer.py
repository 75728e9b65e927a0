"""Point clouds written as lines of numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcapp.geometry.points import PointCloud
from hpcapp.io.columns import Numbers
from hpcapp.io.rows import write_rows
from hpcapp.io.staging import replacing


def write_text_points(path: Path, cloud: PointCloud) -> None:
    """Write a cloud, in the input's frame, as lines of numbers that `open_text` reads back."""
    columns: list[Numbers] = [cloud.positions + cloud.origin]
    if cloud.normals is not None:
        columns.append(cloud.normals)
    elif cloud.colours is not None:  # behind an intensity: 6 columns mean normals
        intensity = cloud.attributes.get("intensity", np.zeros(len(cloud), np.uint8))
        columns.append(intensity[:, None])
    if cloud.colours is not None:
        columns.append(cloud.colours)
    numbers = sum(column.shape[1] for column in columns)
    whole = 0 if cloud.colours is None else 3
    template = " ".join(["%.17g"] * (numbers - whole) + ["%d"] * whole)
    with replacing(path) as file:
        file.writelines(write_rows(template + "\n", np.hstack(columns)))
