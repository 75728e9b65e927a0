"""Which side of a patch is seen from somewhere: what was scanned was seen from free space.

::

    viewpoints around the object, or where scanners stood
      each: patches ── six faces of a cube around it ── the nearest in each pixel ──> seen or hidden
"""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.normals.patches import Patches
from hpcapp.geometry.points import BoolArray, FloatArray, Int8Array

_BENT = 0.56
"""Spacings of residual that a plane leaves across two faces at a right angle, 45 degrees off both.
As much more than usual as a patch leaves, by this, the slope of the true surface may differ."""
_STEEPEST = 0.71  # cosine: so far off is a plane across a right angle
_THICK = 0.5  # spacings that a patch may lie behind the plane of what is seen
_NOISES = 3.0  # or so many standard deviations of it, where that is more
_DISTANCE = 2.5  # of the viewpoints around an object, in half diagonals of its box


def surround(patches: Patches, count: int) -> tuple[FloatArray, float, FloatArray]:
    """Return directions (count, 3), a radius and viewpoints (count, 3) all around an object.

    The directions are on the unit sphere, evenly; the viewpoints so far from its box's middle.
    """
    low, high = patches.centres.min(axis=0), patches.centres.max(axis=0)
    radius = _DISTANCE * 0.5 * float(np.sqrt(((high - low) ** 2).sum()))
    # (count,) each: equal steps in height, each a golden angle further around: a Fibonacci sphere.
    number = np.arange(count) + 0.5
    up = 1.0 - 2.0 * number / count
    turn, level = number * np.pi * (3.0 - np.sqrt(5.0)), np.sqrt(1.0 - up**2)
    directions = np.stack([level * np.cos(turn), level * np.sin(turn), up], axis=1)
    return directions, radius, 0.5 * (low + high) + radius * directions


def look(
    patches: Patches, viewpoints: FloatArray, spacing: float, threads: int = 1
) -> tuple[Int8Array, BoolArray]:
    """Look at patches from viewpoints (v, 3): cosines (v, p), and which are seen, (v, p).

    The cosines are between a patch's normal and the direction to the viewpoint, in 127ths; 0 where
    it is not clearly seen: a plane across a sharp edge is seen from behind by who sees one of its
    faces. For what is seen, see `kernels.view_patches`.
    """
    # (p,): how far behind the patch in front one may lie and yet be of the same sheet.
    thickness = np.maximum(_THICK * spacing, _NOISES * patches.noise)
    # (p,): the residual beyond the usual one tells how far the surface bends off its plane, as the
    # tangent of an angle. A view must come from higher above the plane than that.
    usual = float(np.median(patches.noise))
    bend = np.sqrt(np.maximum(patches.noise**2 - usual**2, 0.0)) / (_BENT * spacing)
    least = np.minimum(bend / np.sqrt(1.0 + bend**2), _STEEPEST)
    given = patches.centres, patches.normals, thickness, least
    return kernels.view_patches(*given, viewpoints, spacing, threads)
