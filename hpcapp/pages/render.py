"""A picture of a mesh without any graphics library.

Faces are smooth where their normals are near those of their vertices, and sharp elsewhere. Back
faces have a tint of their own, so that holes and turned faces stand out. Where they hide fronts, as
the near walls of a room do, they are left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import ByteArray
from hpcapp.pages.drawing.camera import Camera, Screen, aim, look_along
from hpcapp.pages.drawing.depth_buffer import DepthBuffer, find_rows
from hpcapp.pages.drawing.light import GREY, light_normals
from hpcapp.pages.drawing.paint import paint
from hpcapp.pages.drawing.shadow import cast_shadow

HIDDEN = 0.4
"""Share of what is seen where backs hide fronts, from which on they are left out: rooms have .53
(one without a ceiling) and more, objects none, sheets up to .28 (stairs, seen from the side where
they rise)."""

IntArray = NDArray[np.int64]
Floats = NDArray[np.float32]

_BACK = np.array([0.68, 0.60, 0.54], np.float32)  # as in static/viewer.js
_FILL = 0.92  # share of the picture's side
_CREASE = 0.87  # cosine: a face that turns by 30 degrees from its vertex is not smoothed there
_FACES = 200_000  # that are worked on at once


def render_mesh(
    mesh: Mesh,
    azimuth: float = 30.0,
    elevation: float = 20.0,
    size: int = 800,
    up: str = "z",
    zoom: float = 1.0,
) -> NDArray[np.uint8]:
    """Draw a mesh in parallel projection, with its shadow on the ground, as (size, size, 3).

    Faces have the colours of their corners, or grey; their backs are light brown. Vertices that are
    not finite are left out with their faces. The eye's angles are in degrees; with a zoom above 1,
    the middle of the picture is seen larger.
    """
    return draw_mesh(mesh, look_along(azimuth, elevation, up), size, up, zoom)[0]


def draw_mesh(
    mesh: Mesh, axes: NDArray[np.float64], size: int, up: str, zoom: float = 1.0
) -> tuple[NDArray[np.uint8], float]:
    """Return the picture of a mesh as `axes` see it, and how many of its pixels a unit has."""
    is_finite = np.logical_and.reduce(np.isfinite(mesh.vertices), axis=1)
    faces = mesh.faces
    if not is_finite.all():
        faces = faces[is_finite[faces].all(axis=1)]
    is_used = np.zeros(len(mesh.vertices), bool)
    is_used[faces.ravel()] = True
    if not is_used.any():
        return np.full((size, size, 3), 255, np.uint8), float(size)
    corners = mesh.vertices[is_used] if not is_used.all() else mesh.vertices
    seen = np.stack([corners @ axis for axis in axes], axis=1)
    camera = aim(axes, seen.min(axis=0), seen.max(axis=0), size, size, _FILL * zoom)
    del seen
    bounds = np.stack([corners.min(axis=0), corners.max(axis=0)])
    surface = _Surface(camera.project(mesh.vertices), faces, mesh.colours)

    def draw(below: Camera, buffer: DepthBuffer) -> None:
        buffer.draw_faces(below.project(mesh.vertices), faces, np.arange(len(faces)))

    shadow = cast_shadow(camera, up, bounds, draw)
    used = surface.screen[is_used, 2]
    nearness = float(used.min()), float(used.max())
    picture = paint(camera, surface, nearness, shadow)
    if surface.backs > HIDDEN * surface.samples:
        inside = _Surface(surface.screen, _take_fronts(surface.screen, faces), mesh.colours)
        fronts = paint(camera, inside, nearness, shadow)
        if inside.samples - surface.samples + surface.backs > HIDDEN * surface.samples:
            picture = fronts
    return picture, camera.pixels_per_unit


class _Surface:
    """Faces on the screen, and how many samples of them, and of their backs, have been shaded."""

    def __init__(self, screen: Screen, faces: IntArray, colours: ByteArray | None) -> None:
        self.screen = screen
        self._faces = faces
        self._colours = colours
        self._rows = find_rows(screen, faces)
        self._normals = _sum_normals(screen, faces)
        self.samples = self.backs = 0

    def enter(self, buffer: DepthBuffer) -> None:
        """Draw the faces that reach into the band."""
        first, last = self._rows[:, 0], self._rows[:, 1]
        is_near = (first < buffer.rows[1]) & (last > buffer.rows[0]) & (last > first)
        buffer.draw_faces(self.screen, self._faces, np.flatnonzero(is_near))

    def shade(self, item: IntArray, column: IntArray, row: IntArray) -> Floats:
        """Return the shades of faces at samples."""
        corners = self._faces[item]
        places = self.screen[corners]
        weights = _weigh(places, column, row)
        flat = _cross_corners(places)
        flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-30)
        # (n, 3, 3): the normals of the corners, of the face itself where that turns away
        smooth = self._normals[corners]
        is_crease = (smooth * flat[:, None]).sum(axis=2) < _CREASE
        smooth = np.where(is_crease[..., None], flat[:, None], smooth)
        normal = (weights[..., None] * smooth).sum(axis=1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        is_front = flat[:, 2] >= 0.0
        normal[~is_front] *= -1.0
        self.samples += len(item)
        self.backs += int(np.count_nonzero(~is_front))
        light = light_normals(normal, is_coloured=self._colours is not None)
        front: Floats = np.array(GREY, np.float32)
        if self._colours is not None:
            corner_colours = self._colours[corners].astype(np.float32) / 255.0
            front = (weights[..., None] * corner_colours).sum(axis=1)
        shades: Floats = light[:, None] * np.where(is_front[:, None], front, _BACK)
        return shades


def _take_fronts(screen: Screen, faces: IntArray) -> IntArray:
    """Return the faces that turn towards the eye."""
    parts = (faces[begin : begin + _FACES] for begin in range(0, len(faces), _FACES))
    return np.concatenate([part[_cross_corners(screen[part])[:, 2] > 0.0] for part in parts])


def _weigh(corners: Floats, column: IntArray, row: IntArray) -> Floats:
    """Return the barycentric coordinates of samples in their faces, shape (n, 3)."""
    sample = np.stack([column + 0.5, row + 0.5], axis=1)
    a, b, c = (corners[:, k, :2].astype(np.float64) - sample for k in range(3))
    areas = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
    total = areas.sum(axis=1, keepdims=True)
    weights = areas / np.where(total == 0.0, 1.0, total)
    return np.clip(weights, 0.0, 1.0).astype(np.float32)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the z component of the cross products of plane vectors."""
    area: NDArray[np.float64] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return area


def _cross_corners(places: Floats) -> Floats:
    """Return twice the area of faces times their normals, as seen; rows count downwards."""
    u, v = places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]
    x = u[:, 2] * v[:, 1] - u[:, 1] * v[:, 2]
    y = u[:, 2] * v[:, 0] - u[:, 0] * v[:, 2]
    z = u[:, 1] * v[:, 0] - u[:, 0] * v[:, 1]
    return np.stack([x, y, z], axis=1)


def _sum_normals(screen: Screen, faces: IntArray) -> Floats:
    """Return the normals of vertices as seen: the means of their faces', weighed by area."""
    normals = np.zeros((len(screen), 3), np.float32)
    for begin in range(0, len(faces), _FACES):
        part = faces[begin : begin + _FACES]
        crosses = _cross_corners(screen[part])
        for k in range(3):
            for axis in range(3):
                np.add.at(normals[:, axis], part[:, k], crosses[:, axis])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return normals
