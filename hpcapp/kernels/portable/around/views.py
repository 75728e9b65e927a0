"""Which patches are seen from a viewpoint: those that nothing lies in front of."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.lattice import number_keys
from hpcapp.geometry.points import BoolArray, FloatArray, Int8Array, Int32Array, IntArray
from hpcapp.kernels.constants import WHOLE

__all__ = ["add_views", "view_patches"]

_PIXEL = 6.0  # spacings: two patches of a sheet, of cells of 4, are seen in a pixel
_LEAST_COSINE = 0.25  # of the angle between a normal and the line of sight
_NEAREST = 1e-12  # spacings
_FINEST = 2.0**-29  # of an edge of 2: pixels of six faces are numbered in 64 bits
_LEVELS = 4  # sizes of pixels, each twice the last, for patches near the viewpoint


def view_patches(
    centres: FloatArray,
    normals: FloatArray,
    thickness: FloatArray,
    least: FloatArray,
    viewpoints: FloatArray,
    spacing: float,
    threads: int = 1,
) -> tuple[Int8Array, BoolArray]:
    """Tell which patches are seen from each of v viewpoints (v, 3).

    Patches have centres and unit normals (p, 3), and `thickness` (p,), in length units of the
    input: how far behind the plane of what is seen they may lie. Above the cosine `least` (p,) of
    the angle between its normal and the line of sight, the side of a patch is certain.

    Returns
    -------
    cosines : ndarray of int8, shape (v, p)
        Between the normal of each patch and the direction to the viewpoint, in 127ths; 0 where
        the patch is not clearly seen: in pixels that are shifted by half of one, too, as at an
        edge what hides it may be in the next pixel, and on a side that is certain.
    is_seen : ndarray of bool, shape (v, p)
        Those seen at less than 75 degrees that nothing lies in front of.

    Notes
    -----
    In each pixel the nearest patch, of several as near the first, hides what lies behind its
    plane. Pixels lie on the faces of a cube around the viewpoint, and are as large as one and a
    half patches at the median distance; a nearer patch fills larger ones.
    """
    del threads
    shape = len(viewpoints), len(centres)
    cosines, is_seen = np.zeros(shape, np.int8), np.zeros(shape, np.bool_)
    if len(centres):
        for row, viewpoint in enumerate(viewpoints):
            patches = centres, normals, thickness, least
            cosines[row], is_seen[row] = _view(*patches, viewpoint, spacing)
    return cosines, is_seen


def add_views(cosines: Int8Array, is_seen: BoolArray) -> tuple[Int32Array, Int32Array, BoolArray]:
    """Add up what v viewpoints see of p patches: `cosines`, `is_seen` (v, p) of `view_patches`.

    Return the sums of the cosines above 0, and of those below it without their sign, and which
    patches are seen from any of the viewpoints; all (p,).
    """
    front = np.maximum(cosines, 0).sum(axis=0, dtype=np.int32)
    back = front - cosines.sum(axis=0, dtype=np.int32)
    return front, back, np.logical_or.reduce(is_seen, axis=0)


def _view(
    centres: FloatArray,
    normals: FloatArray,
    thickness: FloatArray,
    least: FloatArray,
    viewpoint: FloatArray,
    spacing: float,
) -> tuple[Int8Array, BoolArray]:
    """Return the rows of one viewpoint; see `view_patches`."""
    arms = viewpoint - centres
    # Whoever stands on a point is a little way off it, or its pixel would be endless.
    far = np.maximum(np.sqrt(_dot(arms, arms)), max(_NEAREST * spacing, 1e-300))
    cosines = _dot(arms, normals) / far
    places, sides = _project(arms)
    # Of the faces of a cube of half edge 1, whose middle is the viewpoint.
    pixel = max(_PIXEL * spacing / float(np.median(far)), _FINEST)
    # (p,): how many pixels wide each patch looks; level l, to 3, has pixels 2^l times as wide.
    width = _PIXEL * spacing / far / pixel
    level_of = np.sum([width > 2.0**level for level in range(_LEVELS - 1)], axis=0)
    is_seen = np.abs(cosines) > _LEAST_COSINE
    is_clear = np.abs(cosines) > np.maximum(least, _LEAST_COSINE)
    # The patches of each level, drawn in its pixels, hide patches of all levels.
    for level in range(_LEVELS):
        drawn = np.flatnonzero(level_of == level)
        if not len(drawn):
            continue
        # Of several that are written to one pixel the last one stays: so the nearest one is shown.
        farthest_first = drawn[np.argsort(far[drawn], kind="stable")][::-1]
        for shift, seen in ((0.0, is_seen), (0.5, is_clear)):
            pixels = _number_pixels(places, sides, pixel * 2.0**level, shift)
            # (pixels,): the patch that was drawn last
            shown = np.full(int(pixels.max()) + 1, len(far))
            shown[pixels[farthest_first]] = farthest_first
            front = shown[pixels]
            rows = np.flatnonzero(front < len(far))
            front = front[rows]
            # (m,): how far before the plane of the one in front each lies, as the viewer sees it.
            above = _dot(centres[rows] - centres[front], normals[front]) * np.sign(cosines[front])
            seen[rows[(above < -thickness[rows]) & (far[rows] > far[front])]] = False
    return np.where(is_seen & is_clear, np.rint(WHOLE * cosines), 0.0).astype(np.int8), is_seen


def _project(arms: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return where arms meet the faces of a cube of half edge 1, and which of the six faces."""
    # (p,): the longest coordinate tells the face; the others, divided by it, the place there.
    axes = np.argmax(np.abs(arms), axis=1)
    rows = np.arange(len(arms))
    depth = arms[rows, axes]
    scale = np.where(np.abs(depth) > 0.0, np.abs(depth), 1.0)
    across = [arms[rows, (axes + step) % 3] / scale for step in (1, 2)]
    return np.stack(across, axis=1), 2 * axes + (depth > 0.0)


def _number_pixels(places: FloatArray, sides: IntArray, pixel: float, shift: float) -> IntArray:
    """Return a number for the pixel of each place, on a lattice that is shifted."""
    # Pixels along the edge of a face, with one more for the shift and one for rounding.
    edge = int(np.ceil(2.0 / pixel)) + 2
    columns = np.floor((places + 1.0) / pixel + shift).astype(np.int64)
    return number_keys((sides * edge + columns[:, 0]) * edge + columns[:, 1])[1]


def _dot(first: FloatArray, second: FloatArray) -> FloatArray:
    products = first * second
    dots: FloatArray = products[:, 0] + products[:, 1] + products[:, 2]
    return dots
