"""What a camera sees of a mesh, and how well."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.io.cameras.lens import Lens
from hpcapp.io.cameras.poses import Camera
from hpcapp.pages.drawing.depth_buffer import DepthBuffer
from hpcapp.texture.texels import Texels
from hpccomponent.dataclass import dataclass

_MOST_SAMPLES = 1 << 20
"""Of a depth buffer: as many as a picture of 1,000 x 1,000 has."""
_GRID = 65  # directions along a side that tell which part of space a picture shows
_NEAREST = 1e-4  # of the farthest corner: nearer faces are cut
_JUMP = 0.02
"""Change of 1 / z from a sample to the next that is an edge, beside that of a plane, relative to
it: of 1,000 samples to the distance, a crease from straight on to 87 degrees, or a step of 2 %."""
_EDGE = 6.0
"""Samples from an edge within which a photograph counts less: 6 of some 1,000 along a side."""
_AROUND = 2
"""Samples around a place in which nothing may be nearer by the jump of an edge: a pixel there shows
both, and the mesh's outline lies beside the true one."""
_BORDER = 0.03  # of the picture's longer side, within which it counts less
_LEAST = 0.01  # what is left of the score there
_STEEPEST = 0.17
"""Cosine of 80 degrees: what is seen at a smaller angle is smeared over six pixels and more."""


@dataclass(frozen=True, slots=True, eq=False)
class Looks:
    """How a photograph shows places.

    Parameters
    ----------
    rows : ndarray of int64, shape (n,)
        Which of the places are seen.
    pixels : ndarray of float64, shape (n, 2)
        Where: columns and rows from the upper left corner of the picture.
    density : ndarray of float64, shape (n,)
        Pixels in an area of 1, seen straight on.
    scores : ndarray of float64, shape (n,)
        How well: the density times the square of the cosine, less beside edges.
    """

    rows: IntArray
    pixels: FloatArray
    density: FloatArray
    scores: FloatArray


class View:
    """A camera in front of a mesh with normals.

    `faces` are those that it may see: they turn to the camera, and reach into the window.
    """

    def __init__(self, mesh: Mesh, camera: Camera, lens: Lens) -> None:
        assert mesh.normals is not None  # noqa: S101 - it is asked for
        self._lens = lens
        self._low, self._high = _find_window(lens)
        extent = np.maximum(self._high - self._low, 1e-9)
        dense = np.sqrt(_MOST_SAMPLES / extent.prod())
        self._scale = float(min(dense, max(lens.focal)))
        self._places = (mesh.vertices - (camera.centre - mesh.origin)) @ camera.rotation.T
        self._normals = mesh.normals @ camera.rotation.T
        corners = self._places[mesh.faces]
        far = float(np.abs(corners).max(initial=1e-30))
        parts = _cut_near(corners, _NEAREST * far)
        self._near = self._draw(parts, (1.0 / far, 1.0 / _NEAREST / far))
        self._worth = _find_worth(self._near)
        self._front = ndimage.maximum_filter(self._near, 2 * _AROUND + 1)
        crosses = cross_edges(corners)
        reaches = -(crosses * corners[:, 0]).sum(axis=1)  # times the length: above 0 in front
        self.faces = np.flatnonzero((reaches > 0.0) & self._find_inside(corners))
        self._corners = mesh.faces[self.faces]
        # 1 / z of a plane changes by that much from a sample to the next one
        slopes = np.abs(crosses[self.faces, :2]).sum(axis=1) / reaches[self.faces]
        self._slopes = slopes / self._scale

    def _draw(self, corners: FloatArray, nearness: tuple[float, float]) -> FloatArray:
        """Return 1 / z of what is nearest at each sample, 0 where nothing is."""
        width, height = np.ceil((self._high - self._low) * self._scale).astype(int) + 1
        flat = corners.reshape(-1, 3)
        screen = np.empty((len(flat), 3))
        screen[:, 2] = 1.0 / flat[:, 2]
        screen[:, :2] = self._to_samples(flat[:, :2] * screen[:, 2:])
        buffer = DepthBuffer((0, int(height)), int(width), nearness)
        buffer.draw_faces(screen, np.arange(len(flat)).reshape(-1, 3), np.arange(len(corners)))
        return np.maximum(buffer.nearness(1), 0.0).astype(np.float64)

    def _to_samples(self, directions: FloatArray) -> FloatArray:
        """Return where directions lie in the depth buffer, whose samples have middles at .5."""
        samples: FloatArray = (directions - self._low) * self._scale
        return samples

    def _find_inside(self, corners: FloatArray) -> BoolArray:
        """Tell which faces may reach into the window."""
        z = corners[:, :, 2]
        is_inside: BoolArray = np.logical_or.reduce(z > 0.0, axis=1)
        is_whole = (z > 0.0).all(axis=1)
        flat = corners[is_whole, :, :2] / corners[is_whole, :, 2:]
        is_in = (flat.max(axis=1) >= self._low) & (flat.min(axis=1) <= self._high)
        is_inside[is_whole] &= is_in.all(axis=1)
        return is_inside

    def look(self, texels: Texels) -> Looks:
        """Return how the camera sees texels of its `faces`."""
        x, y, z = texels.blend(self._places, self._corners).T
        a, b, c = texels.blend(self._normals, self._corners).T
        squares = x * x + y * y + z * z
        lengths = np.sqrt(squares * (a * a + b * b + c * c))
        cosines = -(a * x + b * y + c * z) / np.maximum(lengths, 1e-300)
        rows = np.flatnonzero((z > 0.0) & (cosines > _STEEPEST))
        near = 1.0 / z[rows]
        directions = np.stack([x[rows] * near, y[rows] * near], axis=1)
        (left, top), (right, bottom) = self._low, self._high
        across, down = directions.T
        is_in = (across >= left) & (across <= right) & (down >= top) & (down <= bottom)
        rows, directions, near = rows[is_in], directions[is_in], near[is_in]
        pixels = self._lens.project(directions)
        across, down = pixels.T
        width, height = self._lens.size
        border = np.minimum(np.minimum(across, width - across), np.minimum(down, height - down))
        slopes = self._slopes[texels.faces[rows]] + near / self._scale
        worth = self._find_free(directions, near, slopes)
        is_free = (worth > 0.0) & (border > 1.0)
        rows, pixels = rows[is_free], pixels[is_free]
        inside = np.clip(border[is_free] / (_BORDER * max(width, height)), _LEAST, 1.0)
        density = self._lens.focal[0] * self._lens.focal[1] / squares[rows]
        scores = density * cosines[rows] ** 2 * inside * worth[is_free]
        return Looks(rows, pixels, density, scores)

    def _find_free(
        self, directions: FloatArray, near: FloatArray, slopes: FloatArray
    ) -> FloatArray:
        """Return how far from edges places are seen, 0 to 1; 0 of those that something hides.

        Of places so near none of the four samples around may be nearer by the slope from one
        sample to the next, and none beside these in front of an edge.
        """
        at = self._to_samples(directions) - 0.5
        last = np.array(self._near.shape[::-1]) - 1
        low = np.clip(np.floor(at).astype(np.int64), 0, last)
        high = np.minimum(low + 1, last)
        nearest = np.clip(np.rint(at).astype(np.int64), 0, last)
        limits = near * (1.0 + _JUMP) + (_AROUND + 1) * slopes
        is_free: BoolArray = self._front[nearest[:, 1], nearest[:, 0]] <= limits
        limits = near + slopes
        for columns in (low[:, 0], high[:, 0]):
            for rows in (low[:, 1], high[:, 1]):
                is_free &= self._near[rows, columns] <= limits
        worth: FloatArray = self._worth[nearest[:, 1], nearest[:, 0]] * is_free
        return worth


def _find_window(lens: Lens) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest x and y, at a distance of 1, that a picture shows."""
    reach = lens.find_reach()
    along = np.linspace(-reach, reach, _GRID)
    directions = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    directions = directions[(directions**2).sum(axis=1) <= reach * reach]
    pixels = lens.project(directions)
    inside = directions[((pixels >= 0.0) & (pixels <= lens.size)).all(axis=1)]
    step = along[1] - along[0]
    low, high = inside.min(axis=0, initial=0.0), inside.max(axis=0, initial=0.0)
    return np.maximum(low - step, -reach), np.minimum(high + step, reach)


def _cut_near(corners: FloatArray, near: float) -> FloatArray:
    """Return the parts (m, 3, 3) of triangles (n, 3, 3) beyond a plane z = near."""
    before = corners[:, :, 2] < near
    counts = before.sum(axis=1)
    parts = [corners[counts == 0]]
    for count in (1, 2):
        cut = corners[counts == count]
        lone = np.argmax(before[counts == count] == (count == 1), axis=1)
        # the corner that is alone on its side, and the others after it
        a, b, c = (cut[np.arange(len(cut)), (lone + step) % 3] for step in range(3))
        ab, ac = (
            a + ((near - a[:, 2]) / (end[:, 2] - a[:, 2]))[:, None] * (end - a) for end in (b, c)
        )
        whole = [(ab, b, c), (ab, c, ac)] if count == 1 else [(a, ab, ac)]
        parts += [np.stack(part, axis=1) for part in whole]
    return np.concatenate(parts)


def _find_worth(near: FloatArray) -> FloatArray:
    """Return for each sample how much it counts: less near edges behind which something lies."""
    is_edge = np.zeros(near.shape, np.bool_)
    for values, edges in ((near, is_edge), (near.T, is_edge.T)):
        bend = np.abs(values[2:] - 2.0 * values[1:-1] + values[:-2])
        edges[1:-1] |= bend > _JUMP * values[1:-1]
    if not is_edge.any():
        return np.ones(near.shape)
    far = ndimage.distance_transform_edt(~is_edge)
    worth: FloatArray = np.clip((far - 1.0) / _EDGE, _LEAST, 1.0)
    return worth
