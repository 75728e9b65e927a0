"""The points of a cloud in the colours of their spacing: dense ones blue, sparse ones yellow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hpcapp.applications.surface.cloud.measured import find_scale
from hpcapp.applications.surface.types.points import PointCloud

__all__ = ["colour_by_spacing"]

_DOUBLINGS = 3.0  # of the whole cloud's spacing, up and down, from end to end of the colours
_COLOURS = np.array([(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)])


def colour_by_spacing(cloud: PointCloud) -> PointCloud:
    """Return the finite points of a cloud, each in the colour of the spacing around it.

    Raises
    ------
    InputError
        All points are the same.
    """
    finite = cloud.take(np.flatnonzero(np.isfinite(cloud.positions).all(axis=1)))
    scale = find_scale(finite.positions)
    doublings = np.log2(scale.at(finite.positions) / scale.spacing)
    at = (doublings / _DOUBLINGS + 1.0).clip(0.0, 2.0) * (len(_COLOURS) - 1) / 2.0
    places = np.arange(len(_COLOURS))
    colours = [np.interp(at, places, channel) for channel in _COLOURS.T]
    return replace(finite, colours=np.stack(colours, axis=1).round().astype(np.uint8))
