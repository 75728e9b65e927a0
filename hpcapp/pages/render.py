"""A picture of a mesh without any graphics library.

A z-buffer in numpy: faces are cut into pixels by their bounding boxes, a chunk of faces at a
time; every pixel keeps the nearest one. Back faces are drawn in red, so that holes and turned
faces stand out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.types.mesh import Mesh
from hpcapp.applications.surface.types.points import FloatArray

__all__ = ["render_mesh"]

Picture = NDArray[np.uint8]

_FRONT = np.array([0.80, 0.82, 0.86])
_BACK = np.array([0.85, 0.25, 0.20])
_BACKGROUND = 1.0
_CHUNK_PIXELS = 4_000_000  # bounds the memory, about 100 bytes a pixel


def render_mesh(
    mesh: Mesh,
    azimuth: float = 30.0,
    elevation: float = 20.0,
    size: int = 800,
    up: str = "z",
    zoom: float = 1.0,
) -> Picture:
    """Draw a mesh in parallel projection, each face in one shade of its colour.

    Parameters
    ----------
    mesh : Mesh
        Faces have the mean colour of their corners, or grey where there are no colours; their
        backs are red. Vertices that are not finite are left out with their faces.
    azimuth, elevation : float
        Where the eye is, in degrees.
    size : int
        Width and height of the picture in pixels.
    up : {"x", "y", "z"}
        The axis that points up.
    zoom : float
        Above 1, the middle of the picture is seen larger.

    Returns
    -------
    ndarray of uint8, shape (size, size, 3)
    """
    fine = 2 * size  # averaged down at the end: smooth outlines
    is_finite = np.logical_and.reduce(np.isfinite(mesh.vertices), axis=1)
    faces = mesh.faces[is_finite[mesh.faces].all(axis=1)]
    view = _view(mesh.vertices, azimuth, elevation, up)
    used = view[np.unique(faces)] if len(faces) else np.zeros((1, 3))
    low, high = used.min(axis=0), used.max(axis=0)
    scale = 0.92 * zoom * fine / max(float((high - low)[:2].max()), 1e-300)
    screen = (view - 0.5 * (low + high)) * scale + [0.5 * fine, 0.5 * fine, 0.0]
    nearest = _rasterise(screen, faces, fine)
    front = _FRONT if mesh.colours is None else mesh.colours[faces].mean(axis=1) / 255.0
    shades = np.concatenate([_shade(screen, faces, front), np.full((1, 3), _BACKGROUND)])
    image = shades[nearest].reshape(size, 2, size, 2, 3).mean(axis=(1, 3))
    picture: Picture = (255.0 * np.clip(image[::-1], 0.0, 1.0) + 0.5).astype(np.uint8)
    return picture


def _view(vertices: FloatArray, azimuth: float, elevation: float, up: str) -> FloatArray:
    """Return vertices as seen: x to the right, y up, z towards the eye."""
    turned = np.roll(vertices, 2 - "xyz".index(up), axis=1)
    az, el = np.radians([azimuth, elevation])
    eye = np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])
    right = np.array([-np.sin(az), np.cos(az), 0.0])
    seen: FloatArray = turned @ np.stack([right, np.cross(eye, right), eye], axis=1)
    return seen


def _shade(screen: FloatArray, faces: NDArray[np.int64], front: FloatArray) -> FloatArray:
    """Return one colour per face: a light over the left shoulder, a weaker one from below."""
    a, b, c = (screen[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    is_front = normal[:, 2] >= 0.0
    normal = np.where(is_front[:, None], normal, -normal)
    key, fill = np.array([-0.45, 0.55, 0.70]), np.array([0.6, -0.5, 0.6])
    light = 0.16 + 0.80 * np.maximum(normal @ key, 0.0) + 0.24 * np.maximum(normal @ fill, 0.0)
    shade: FloatArray = light[:, None] * np.where(is_front[:, None], front, _BACK)
    return shade


def _rasterise(screen: FloatArray, faces: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """Return the nearest face of each pixel, shape (size, size); -1 where there is none."""
    # (f, 3, 3): the corners on the screen; (f, 2): the pixels that their box covers
    corners = screen[faces]
    low = np.clip(np.ceil(corners[:, :, :2].min(axis=1) - 0.5), 0, size).astype(np.int64)
    high = np.clip(np.ceil(corners[:, :, :2].max(axis=1) - 0.5), 0, size).astype(np.int64)
    width, height = (high - low).T
    area = width * height
    depth = np.full(size * size, -np.inf)
    nearest = np.full(size * size, -1, dtype=np.int64)
    visible = np.flatnonzero(area > 0)
    bounds = np.cumsum(area[visible]) // _CHUNK_PIXELS
    for part in np.split(visible, np.flatnonzero(np.diff(bounds)) + 1):
        # (c,): a candidate for each pixel in the box of each face; its place in that box
        face = np.repeat(part, area[part])
        rank = np.arange(len(face)) - np.repeat(np.cumsum(area[part]) - area[part], area[part])
        row, column = np.divmod(rank, width[face])
        _keep_nearest(
            corners[face], face, low[face, 0] + column, low[face, 1] + row, size, depth, nearest
        )
    return nearest.reshape(size, size)


def _keep_nearest(
    corners: FloatArray,
    face: NDArray[np.int64],
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    size: int,
    depth: FloatArray,
    nearest: NDArray[np.int64],
) -> None:
    """Enter those candidate pixels that lie in their triangles and before what was there."""
    # (c, 2): the pixel's middle; the corners about it
    spot = np.stack([x + 0.5, y + 0.5], axis=1)
    a, b, c = (corners[:, k, :2] - spot for k in range(3))
    # (c, 3): barycentric coordinates, unscaled: of one sign inside
    weights = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
    total = weights.sum(axis=1)
    inside = ((weights >= 0.0).all(axis=1) | (weights <= 0.0).all(axis=1)) & (total != 0.0)
    z = (weights[inside] * corners[inside, :, 2]).sum(axis=1) / total[inside]
    pixel, face = (y * size + x)[inside], face[inside]
    # the last of a pixel is its nearest candidate; it wins if it is before what was there
    order = np.lexsort((z, pixel))
    last = np.flatnonzero(np.r_[pixel[order][1:] != pixel[order][:-1], len(order) > 0])
    winner = order[last]
    winner = winner[z[winner] > depth[pixel[winner]]]
    depth[pixel[winner]], nearest[pixel[winner]] = z[winner], face[winner]


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the z component of the cross products of plane vectors."""
    area: FloatArray = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return area
