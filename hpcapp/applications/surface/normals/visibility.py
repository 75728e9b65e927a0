"""Which side of a patch is seen from somewhere: what was scanned was seen from free space.

::

    viewpoints around the object, or where scanners stood
      each: patches ── six faces of a cube around it ── the nearest in each pixel ──> seen or hidden
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.normals.patches import CELL, Patches
from hpcapp.cancellation import check_cancelled
from hpcapp.geometry.lattice import number_keys
from hpcapp.geometry.points import BoolArray, FloatArray, Int8Array, IntArray

WHOLE = 127.0
"""What a cosine of one is as an int8."""

_PIXEL = 1.5 * CELL  # spacings: two patches of a sheet are seen in a pixel
_LEAST_COSINE = 0.25  # of the angle between a normal and the line of sight
_BENT = 0.56
"""Spacings of residual that a plane leaves across two faces at a right angle, 45 degrees off both.
As much more than usual as a patch leaves, by this, the slope of the true surface may differ."""
_STEEPEST = 0.71  # cosine: so far off is a plane across a right angle
_NEAREST = 1e-12  # spacings
_THICK = 0.5  # spacings that a patch may lie behind the plane of what is seen
_NOISES = 3.0  # or so many standard deviations of it, where that is more
_DISTANCE = 2.5  # of the viewpoints around an object, in half diagonals of its box
_FINEST = 2.0**-29  # of an edge of 2: pixels of six faces are numbered in 64 bits
_LARGE = 64  # pixels of an image for each patch
_CLOSE = 4  # sizes of pixels, each twice the last, for patches near the viewpoint


def surround(patches: Patches, count: int) -> tuple[FloatArray, float, FloatArray]:
    """Return viewpoints all around an object.

    Returns
    -------
    directions : ndarray of float64, shape (count, 3)
        On the unit sphere, evenly.
    radius : float
        In length units of the input.
    viewpoints : ndarray of float64, shape (count, 3)
        So far from the middle of the object's box.
    """
    low, high = patches.centres.min(axis=0), patches.centres.max(axis=0)
    radius = _DISTANCE * 0.5 * float(np.sqrt(((high - low) ** 2).sum()))
    # (count,) each: equal steps in height, each a golden angle further around: a Fibonacci sphere.
    number = np.arange(count) + 0.5
    up = 1.0 - 2.0 * number / count
    turn, level = number * np.pi * (3.0 - np.sqrt(5.0)), np.sqrt(1.0 - up**2)
    directions = np.stack([level * np.cos(turn), level * np.sin(turn), up], axis=1)
    return directions, radius, 0.5 * (low + high) + radius * directions


def look(patches: Patches, viewpoint: FloatArray, spacing: float) -> tuple[Int8Array, BoolArray]:
    """Look at patches from a viewpoint.

    Parameters
    ----------
    patches : Patches
    viewpoint : ndarray of float64, shape (3,)
        In length units of the input.
    spacing : float
        Of the cloud, in length units of the input.

    Returns
    -------
    cosines : ndarray of int8, shape (p,)
        Between the normal of each patch and the direction to the viewpoint, in 127ths; 0 where
        the patch is not clearly seen from there.
    is_seen : ndarray of bool, shape (p,)
        See `find_seen`.
    """
    cosines, is_seen, is_clear = find_seen(patches, viewpoint, spacing)
    return np.where(is_clear, np.rint(WHOLE * cosines), 0.0).astype(np.int8), is_seen


def find_seen(
    patches: Patches, viewpoint: FloatArray, spacing: float
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Find the patches that are seen from a viewpoint.

    Parameters
    ----------
    patches : Patches
    viewpoint : ndarray of float64, shape (3,)
        In length units of the input.
    spacing : float
        Of the cloud, in length units of the input.

    Returns
    -------
    cosines : ndarray of float64, shape (p,)
        Of the angle between the normal and the direction to the viewpoint.
    is_seen : ndarray of bool, shape (p,)
        Those seen at less than 75 degrees that nothing lies in front of.
    is_clear : ndarray of bool, shape (p,)
        Those of them that are seen in pixels that are shifted by half of one, too: at an edge,
        what hides a patch may be in the next pixel. And on a side that their normal is sure of:
        a plane across a sharp edge is seen from behind by who sees one of its faces.

    Notes
    -----
    In each pixel the nearest patch hides what lies behind its plane. Pixels are as large as one
    and a half patches at the median distance; a nearer patch fills larger ones.
    """
    arms = viewpoint - patches.centres
    # Whoever stands on a point is a little way off it, or its pixel would be endless.
    far = np.maximum(np.sqrt(np.einsum("ij,ij->i", arms, arms)), max(_NEAREST * spacing, 1e-300))
    cosines = np.einsum("ij,ij->i", arms, patches.normals) / far
    # (p,): how far behind the patch in front one may lie and yet be of the same sheet.
    thick = np.maximum(_THICK * spacing, _NOISES * patches.noise)
    places, sides = _project(arms)
    # Of the faces of a cube of half edge 1, whose middle is the viewpoint.
    pixel = max(_PIXEL * spacing / float(np.median(far)), _FINEST)
    # (p,): how many pixels wide each patch looks; level l, to 3, has pixels 2^l times as wide.
    near = np.maximum(_PIXEL * spacing / far / pixel, 1e-300)
    level_of = np.clip(np.ceil(np.log2(near)), 0, _CLOSE - 1).astype(np.int64)
    is_seen = np.abs(cosines) > _LEAST_COSINE
    # (p,): the residual beyond the usual one tells how far the surface bends off its plane, as the
    # tangent of an angle. A view must come from higher above the plane than that.
    usual = float(np.median(patches.noise))
    bend = np.sqrt(np.maximum(patches.noise**2 - usual**2, 0.0)) / (_BENT * spacing)
    least = np.minimum(bend / np.sqrt(1.0 + bend**2), _STEEPEST)
    is_clear = np.abs(cosines) > np.maximum(least, _LEAST_COSINE)
    # The patches of each level, drawn in its pixels, hide patches of all levels.
    for level in range(int(level_of.max(initial=0)) + 1):
        drawn = np.flatnonzero(level_of == level)
        if not len(drawn):
            continue
        # Of several that are written to one pixel the last one stays: so the nearest one is shown.
        farthest_first = drawn[np.argsort(far[drawn], kind="stable")][::-1]
        for shift, seen in ((0.0, is_seen), (0.5, is_clear)):
            check_cancelled()
            pixels = _name_pixels(places, sides, pixel * 2.0**level, shift)
            seen &= ~_find_hidden(patches, cosines, far, thick, pixels, farthest_first)
    return cosines, is_seen, is_seen & is_clear


def _find_hidden(
    patches: Patches,
    cosines: FloatArray,
    far: FloatArray,
    thick: FloatArray,
    pixels: IntArray,
    drawn: IntArray,
) -> BoolArray:
    """Tell which patches lie behind the nearest of those drawn, farthest first, in their pixel."""
    # (pixels,): the patch that was drawn last
    shown = np.full(int(pixels.max()) + 1, len(patches))
    shown[pixels[drawn]] = drawn
    front = shown[pixels]
    rows = np.flatnonzero(front < len(patches))
    front = front[rows]
    arms = patches.centres[rows] - patches.centres[front]
    # (m,): how far before the plane of the one in front each lies, as seen by the viewer.
    above = np.einsum("ij,ij->i", arms, patches.normals[front]) * np.sign(cosines[front])
    is_hidden = np.zeros(len(patches), np.bool_)
    is_hidden[rows] = (above < -thick[rows]) & (far[rows] > far[front])
    return is_hidden


def _project(arms: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return where arms meet the faces of a cube of half edge 1, and which of the six faces."""
    # (p,): the longest coordinate tells the face; the others, divided by it, the place there.
    axes = np.argmax(np.abs(arms), axis=1)
    rows = np.arange(len(arms))
    depth = arms[rows, axes]
    scale = np.where(np.abs(depth) > 0.0, depth, 1.0)
    across = [arms[rows, (axes + step) % 3] / np.abs(scale) for step in (1, 2)]
    return np.stack(across, axis=1), 2 * axes + (depth > 0.0)


def _name_pixels(places: FloatArray, sides: IntArray, pixel: float, shift: float) -> IntArray:
    """Return a number for the pixel of each place, on a lattice that is shifted."""
    # Pixels along the edge of a face, with one more for the shift and one for rounding.
    edge = int(np.ceil(2.0 / pixel)) + 2
    columns = np.floor((places + 1.0) / pixel + shift).astype(np.int64)
    names: IntArray = (sides * edge + columns[:, 0]) * edge + columns[:, 1]
    # Of an image that is larger than its patches are many, only pixels with some are numbered.
    return names if 6 * edge * edge < _LARGE * len(names) else number_keys(names)[1]
