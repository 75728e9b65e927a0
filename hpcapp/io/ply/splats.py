"""Gaussian splats in PLY files: flat ellipsoids, whose shortest axis is the normal.

Training leaves floaters beside those that make the surface: fog in the air, hardly opaque, that
explains what single images saw. They are no surface, and are left out.

References
----------
Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering", 2023.
doi:10.1145/3592433
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import BoolArray, FloatArray, PointCloud
from hpcapp.io.columns import Numbers
from hpcapp.io.points.named_columns import ColumnPlan, build_cloud, stack

FLOATERS = "splats that are hardly opaque"

_OPACITY = 0.3
"""Splats of less are floaters. Training prunes below 0.005 (Kerbl et al.) or 0.1 (nerfstudio), and
what is left of these lies about 0.04 (logit -3.2, deviation 0.8), surfaces about 0.94 (2.7, 0.9).
"""

_BANDS = ("f_dc_0", "f_dc_1", "f_dc_2")
_SCALES = ("scale_0", "scale_1", "scale_2")
_ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
_CONSTANT_BAND = 0.28209479177387814
"""The spherical harmonic of degree 0: 1 / (2 sqrt(pi))."""


def are_splats(names: Collection[str]) -> bool:
    """Tell by their properties whether vertices are splats, perhaps flat, of two scales."""
    return all(name in names for name in (*_BANDS, *_SCALES[:2], *_ROTATION))


def plan_splats(plan: ColumnPlan) -> ColumnPlan:
    """Leave out what makes a splat, and the normals, which are zero by custom."""
    splat_columns = (*_BANDS, *_SCALES, *_ROTATION)
    others = (
        (ours, name)
        for ours, name in plan.attributes
        if name not in splat_columns and not name.startswith("f_rest_")
    )
    return ColumnPlan(plan.positions, (), (), tuple(others))


def build_splats(columns: Mapping[str, Numbers], plan: ColumnPlan) -> PointCloud:
    """Copy splats into a point cloud, as `plan_splats` has planned it.

    Normals are the shortest axes, up to their sign; colours, from 0 to 1, those of the constant
    band.
    """
    scales = [name for name in _SCALES if name in columns]
    shortest = np.full(len(columns[scales[0]]), 2)
    if len(scales) == len(_SCALES):
        shortest = np.argmin(stack(columns, scales), axis=1)
    colours = np.clip(0.5 + _CONSTANT_BAND * stack(columns, _BANDS), 0.0, 1.0)
    return replace(
        build_cloud(columns, plan),
        normals=_rotated_axes(stack(columns, _ROTATION), shortest),
        colours=colours.astype(np.float32),
    )


def find_floaters(cloud: PointCloud) -> BoolArray:
    """Tell which splats are hardly opaque; their attribute ``opacity`` is the logit of it."""
    logits = cloud.attributes.get("opacity")
    if logits is None:
        return np.zeros(len(cloud), np.bool_)
    is_floater: BoolArray = logits < np.log(_OPACITY / (1.0 - _OPACITY))
    return is_floater


def _rotated_axes(quaternions: FloatArray, axes: NDArray[np.intp]) -> FloatArray:
    """Rotate an axis of the frame by each quaternion w, x, y, z, of any length."""
    w, x, y, z = quaternions.T
    rows = np.arange(len(axes))
    with np.errstate(all="ignore"):  # of a quaternion that is none, NaN
        columns = np.array(
            [
                [w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)],
                [2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)],
                [2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z],
            ]
        )
        rotated: FloatArray = columns[axes, :, rows] / (quaternions**2).sum(axis=1)[:, None]
    return rotated
