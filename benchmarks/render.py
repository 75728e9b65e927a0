"""A picture of a mesh without any graphics library: python benchmarks/render.py MESH -o PNG.

A z-buffer in numpy: faces are cut into pixels by their bounding boxes, a chunk of faces at a
time; every pixel keeps the nearest one. Back faces are drawn in red, so that holes and turned
faces stand out.
"""

from __future__ import annotations

import argparse
import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.io import read_mesh
from hpccomponent.surface.types.mesh import Mesh
from hpccomponent.surface.types.points import FloatArray

__all__ = ["render_mesh", "write_png"]

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
    """Draw a mesh in parallel projection, each face in one shade.

    Parameters
    ----------
    mesh : Mesh
    azimuth, elevation : float
        Where the eye is, in degrees.
    size : int
        Width and height of the picture in pixels.
    up : {"x", "y", "z"}
        The axis that points up.
    zoom : float

    Returns
    -------
    ndarray of uint8, shape (size, size, 3)
    """
    fine = 2 * size  # averaged down at the end: smooth outlines
    view = _view(mesh.vertices, azimuth, elevation, up)
    used = view[np.unique(mesh.faces)] if len(mesh.faces) else np.zeros((1, 3))
    low, high = used.min(axis=0), used.max(axis=0)
    scale = 0.92 * zoom * fine / max(float((high - low)[:2].max()), 1e-300)
    screen = (view - 0.5 * (low + high)) * scale + [0.5 * fine, 0.5 * fine, 0.0]
    nearest = _rasterise(screen, mesh.faces, fine)
    colors = np.concatenate([_shade(screen, mesh.faces), np.full((1, 3), _BACKGROUND)])
    image = colors[nearest].reshape(size, 2, size, 2, 3).mean(axis=(1, 3))
    picture: Picture = (255.0 * np.clip(image[::-1], 0.0, 1.0) + 0.5).astype(np.uint8)
    return picture


def write_png(path: Path, picture: Picture) -> None:
    """Write a picture as PNG.

    Parameters
    ----------
    path : Path
    picture : ndarray of uint8, shape (height, width, 3)
    """
    height, width, _ = picture.shape
    rows = np.concatenate([np.zeros((height, 1), np.uint8), picture.reshape(height, -1)], axis=1)

    def chunk(kind: bytes, body: bytes) -> bytes:
        checksum = struct.pack(">I", zlib.crc32(kind + body))
        return struct.pack(">I", len(body)) + kind + body + checksum

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(rows.tobytes(), 6))
        + chunk(b"IEND", b"")
    )


def _view(vertices: FloatArray, azimuth: float, elevation: float, up: str) -> FloatArray:
    """Return vertices as seen: x to the right, y up, z towards the eye."""
    turned = np.roll(vertices, 2 - "xyz".index(up), axis=1)
    az, el = np.radians([azimuth, elevation])
    eye = np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])
    right = np.array([-np.sin(az), np.cos(az), 0.0])
    seen: FloatArray = turned @ np.stack([right, np.cross(eye, right), eye], axis=1)
    return seen


def _shade(screen: FloatArray, faces: NDArray[np.int64]) -> FloatArray:
    """Return one colour per face: a light over the left shoulder, a weaker one from below."""
    a, b, c = (screen[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    is_front = normal[:, 2] >= 0.0
    normal = np.where(is_front[:, None], normal, -normal)
    key, fill = np.array([-0.45, 0.55, 0.70]), np.array([0.6, -0.5, 0.6])
    light = 0.16 + 0.80 * np.maximum(normal @ key, 0.0) + 0.24 * np.maximum(normal @ fill, 0.0)
    shade: FloatArray = light[:, None] * np.where(is_front[:, None], _FRONT, _BACK)
    return shade


def _rasterise(screen: FloatArray, faces: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """Return the nearest face of each pixel, shape (size, size); -1 where there is none."""
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
    spot = np.stack([x + 0.5, y + 0.5], axis=1)
    a, b, c = (corners[:, k, :2] - spot for k in range(3))
    weights = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
    total = weights.sum(axis=1)
    inside = ((weights >= 0.0).all(axis=1) | (weights <= 0.0).all(axis=1)) & (total != 0.0)
    z = (weights[inside] * corners[inside, :, 2]).sum(axis=1) / total[inside]
    pixel, face = (y * size + x)[inside], face[inside]
    order = np.lexsort((z, pixel))
    last = np.flatnonzero(np.r_[pixel[order][1:] != pixel[order][:-1], len(order) > 0])
    winner = order[last]
    winner = winner[z[winner] > depth[pixel[winner]]]
    depth[pixel[winner]], nearest[pixel[winner]] = z[winner], face[winner]


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the z component of the cross products of plane vectors."""
    area: FloatArray = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return area


def main() -> None:
    """Draw one mesh."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True, help="the PNG to write")
    parser.add_argument("--view", default="30,20", help="azimuth,elevation in degrees")
    parser.add_argument("--size", type=int, default=800, help="pixels")
    parser.add_argument("--up", choices=["x", "y", "z"], default="z")
    parser.add_argument("--zoom", type=float, default=1.0)
    args = parser.parse_args()
    azimuth, elevation = (float(part) for part in args.view.split(","))
    picture = render_mesh(read_mesh(args.mesh), azimuth, elevation, args.size, args.up, args.zoom)
    write_png(args.output, picture)


if __name__ == "__main__":
    main()
