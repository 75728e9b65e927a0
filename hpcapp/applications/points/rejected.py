"""The points of a cloud that a job drops because they belong to no surface."""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.cleaning.drive import (
    Cleaned,
    drop_repeated,
    drop_strays,
    thin_lines,
)
from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.reading.reach import drop_far
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.geometry.points import BoolArray, PointCloud
from hpcapp.io import drop_unusable


def take_rejected(cloud: PointCloud, source: str) -> tuple[PointCloud, Cleaned]:
    """Return the outliers, the strays and the lone lines of a cloud, and how many they are.

    Raise InputError where fewer than ten points are usable, or all are the same.
    """
    usable, _ = drop_unusable(cloud, source)
    is_rejected, cleaned, _ = reject_points(usable)
    return usable.take(np.flatnonzero(is_rejected)), cleaned


def reject_points(usable: PointCloud) -> tuple[BoolArray, Cleaned, LocalScale]:
    """Find the outliers, strays and lone lines of finite points as a job does.

    Return which they are (n,), how many, and the scale of those that the job takes. Points that
    scan lines can spare are none of them; z is in the unit of x and y; normals are not asked. Raise
    InputError where all points are the same.
    """
    rows = {"row": np.arange(len(usable))}
    near = drop_far(PointCloud(usable.positions, attributes=rows))
    cloud_pass, _ = drop_repeated(MemoryPass(arrange_cloud(near)))
    cloud_pass, thinned, scale = thin_lines(cloud_pass)
    before = cloud_pass.cloud.points.attributes["row"]
    cloud_pass, found, scale = drop_strays(cloud_pass, scale)
    is_rejected = np.ones(len(usable), np.bool_)
    is_rejected[near.attributes["row"]] = False
    is_rejected[before] = True
    is_rejected[cloud_pass.cloud.points.attributes["row"]] = False
    far = Cleaned(outliers=len(usable) - len(near))
    return is_rejected, far.plus(thinned).plus(found), scale
