"""The points of a cloud in the colours of what is told of their place: little blue, much yellow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hpcapp.applications.points.noise import find_noise
from hpcapp.applications.surface.cloud.measure import find_scale
from hpcapp.geometry.points import FloatArray, PointCloud

_DOUBLINGS = 3.0  # of what is usual, up and down, from end to end of the colours
_COLOURS = np.array([(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)])


def colour_by_spacing(cloud: PointCloud) -> PointCloud:
    """Return the finite points, each in the colour of the spacing around it.

    Raise InputError where all points are the same.
    """
    finite = _take_finite(cloud)
    scale = find_scale(finite.positions)
    return _colour(finite, scale.at(finite.positions), scale.spacing)


def colour_by_noise(cloud: PointCloud) -> PointCloud:
    """Return the finite points, each in the colour of the noise around it.

    Raise InputError where the points have no surface.
    """
    finite = _take_finite(cloud)
    noise = find_noise(finite, find_scale(finite.positions))
    return _colour(finite, noise.places.at(finite.positions), noise.usual)


def _take_finite(cloud: PointCloud) -> PointCloud:
    return cloud.take(np.flatnonzero(np.isfinite(cloud.positions).all(axis=1)))


def _colour(cloud: PointCloud, values: FloatArray, usual: float) -> PointCloud:
    least = np.finfo(np.float64).tiny  # scans without noise are of one colour
    doublings = np.log2(np.maximum(values, least) / max(usual, least))
    at = (doublings / _DOUBLINGS + 1.0).clip(0.0, 2.0) * (len(_COLOURS) - 1) / 2.0
    places = np.arange(len(_COLOURS))
    colours = [np.interp(at, places, channel) for channel in _COLOURS.T]
    return replace(cloud, colours=np.stack(colours, axis=1).round().astype(np.uint8))
