"""Point clouds written as .npz, which `open_npy` reads back."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
from numpy.lib import format as npy_format

from hpcapp.geometry.points import PointCloud
from hpcapp.io.columns import Numbers
from hpcapp.io.staging import replacing

_OWN = ("positions", "normals", "colours")


def write_npz_points(path: Path, cloud: PointCloud) -> None:
    """Write a point cloud as arrays ``positions``, ``normals``, ``colours`` and its attributes.

    Positions are in the input's frame, to the last digit. The same cloud gives the same bytes.
    """
    arrays: dict[str, Numbers] = {"positions": cloud.positions + cloud.origin}
    if cloud.normals is not None:
        arrays["normals"] = cloud.normals
    if cloud.colours is not None:
        arrays["colours"] = cloud.colours
    for name, values in cloud.attributes.items():
        arrays[f"{name}_attribute" if name in _OWN else name] = values
    with replacing(path) as file, zipfile.ZipFile(file, "w") as archive:
        for name, values in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy")
            with archive.open(member, "w", force_zip64=True) as target:
                npy_format.write_array(target, np.ascontiguousarray(values), allow_pickle=False)
