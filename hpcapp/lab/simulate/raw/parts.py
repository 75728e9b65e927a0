"""What scenes are made of: a field that rays meet, and the same surface as triangles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.lab.simulate.fields import SolidField, cut, unite
from hpcapp.lab.simulate.implicit import Solid, diagonal_of
from hpcapp.lab.simulate.rays import fall, run_in_blocks
from hpcapp.lab.simulate.solids import box
from hpccomponent.dataclass import dataclass

Box = tuple[Sequence[float], Sequence[float], bool]
"""Lowest and highest corner, and whether it is filled or cut out."""

OTHER, GROUND, VEGETATION, BUILDING = 1, 2, 5, 6
"""Classes of LAS."""

_MODEL_CELLS = 250  # along the diagonal
_TRUNK_SIDES = 24
_SUNK = 2.0  # metres that the walls of a house go into the ground


@dataclass(frozen=True, slots=True, eq=False)
class ScenePart:
    """Something solid, what can be seen of its surface, and its class of LAS."""

    field: SolidField
    mesh: Mesh
    kind: int


class HeightField:
    """Ground whose height is linear over the triangles of a square grid.

    Heights (rows, columns) are at the nodes, a step apart: x runs along the columns, y along the
    rows, both from 0.
    """

    def __init__(self, heights: FloatArray, step: float) -> None:
        self._heights, self._step = heights, step
        along, across = np.diff(heights, axis=1), np.diff(heights, axis=0)
        # each triangle has one edge of either direction: no slope is larger than both largest ones
        steepest = np.hypot(np.abs(along).max(), np.abs(across).max()) / step
        self._flatten = 1.0 / float(np.hypot(1.0, steepest))

    def evaluate_height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the height at places, shape (n,); beyond the border its triangles go on."""
        height, _, _ = self._interpolate(x, y)
        return height

    def as_part(self) -> ScenePart:
        """Return the ground as something that rays meet from above."""

        def value(points: FloatArray) -> FloatArray:
            x, y, z = points.T
            above: FloatArray = self._flatten * (z - self.evaluate_height(x, y))
            return above

        def gradient(points: FloatArray) -> FloatArray:
            _, along_x, along_y = self._interpolate(points[:, 0], points[:, 1])
            up = np.ones(len(points))
            return self._flatten * np.stack([-along_x, -along_y, up], axis=1)

        return ScenePart(SolidField(value, gradient), self._triangulate(), GROUND)

    def _interpolate(
        self, x: FloatArray, y: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the height and its derivatives by x and y, each of shape (n,)."""
        rows, columns = self._heights.shape
        u, v = x / self._step, y / self._step
        i = np.clip(np.floor(v), 0, rows - 2).astype(np.int64)
        j = np.clip(np.floor(u), 0, columns - 2).astype(np.int64)
        u, v = u - j, v - i
        # (n,) each: the corners of the cell; its diagonal goes from the first to the last
        a, b = self._heights[i, j], self._heights[i, j + 1]
        c, d = self._heights[i + 1, j], self._heights[i + 1, j + 1]
        is_lower = u >= v
        by_u, by_v = np.where(is_lower, b - a, d - c), np.where(is_lower, d - b, c - a)
        return a + u * by_u + v * by_v, by_u / self._step, by_v / self._step

    def _triangulate(self) -> Mesh:
        rows, columns = self._heights.shape
        y, x = np.mgrid[:rows, :columns] * self._step
        number = np.arange(rows * columns).reshape(rows, columns)
        a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
        faces = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, d), (a, d, c))]
        return Mesh(np.stack([x, y, self._heights], axis=-1).reshape(-1, 3), np.concatenate(faces))


def make_houses(
    corners: Sequence[FloatArray], eaves: Sequence[float], ridges: Sequence[float]
) -> ScenePart:
    """Return houses with gable roofs, whose eaves and ridges are above the lowest corner.

    Corners (4, 3) are where the walls meet the ground, anticlockwise; the ridge runs from the
    middle of the last side to that of the second.
    """
    walls = [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]
    roof = [[5, 6, 9], [7, 4, 8], [4, 5, 9], [4, 9, 8], [6, 7, 8], [6, 8, 9]]
    faces = np.array(walls + roof)
    fields, meshes = [], []
    for feet, eave, ridge in zip(corners, eaves, ridges, strict=True):
        flat = np.column_stack([feet[:, :2], np.full(4, feet[:, 2].min())])
        up = np.array([0.0, 0.0, 1.0])
        ends = 0.5 * np.stack([flat[0] + flat[3], flat[1] + flat[2]]) + ridge * up
        vertices = np.concatenate([flat - _SUNK * up, flat + eave * up, ends])
        meshes.append(Mesh(vertices, faces))
        fields.append(_convex(vertices, faces))
    return ScenePart(unite(*fields), join_meshes(meshes), BUILDING)


def make_trunks(feet: FloatArray, tops: FloatArray, radius: float) -> ScenePart:
    """Return upright cylinders from feet (n, 3), at least 1 m apart, up to heights of tops (n,)."""
    tree, nearest = KDTree(feet[:, :2]), min(4, len(feet))

    def find(points: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Return the value, the distance from the axis, and the number of the nearest trunk."""
        away, number = tree.query(points[:, :2], k=nearest)
        away, number = away.reshape(-1, nearest), number.reshape(-1, nearest)
        values = np.maximum(away - radius, points[:, 2:] - tops[number])
        rows, best = np.arange(len(points)), values.argmin(axis=1)
        return values[rows, best], away[rows, best], number[rows, best]

    def gradient(points: FloatArray) -> FloatArray:
        _, away, number = find(points)
        is_end = points[:, 2] - tops[number] > away - radius
        outward = (points[:, :2] - feet[number, :2]) / np.maximum(away, 1e-300)[:, None]
        return np.column_stack([np.where(is_end[:, None], 0.0, outward), is_end])

    angle = 2.0 * np.pi * np.arange(_TRUNK_SIDES) / _TRUNK_SIDES
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    this = np.arange(_TRUNK_SIDES)
    other = (this + 1) % _TRUNK_SIDES
    wall = [(this, other, other + _TRUNK_SIDES), (this, other + _TRUNK_SIDES, this + _TRUNK_SIDES)]
    lid = (np.full_like(this, 2 * _TRUNK_SIDES), this + _TRUNK_SIDES, other + _TRUNK_SIDES)
    faces = np.concatenate([np.stack(corners, axis=1) for corners in (*wall, lid)])
    meshes = []
    for foot, top in zip(feet, tops, strict=True):
        circle, ones = foot[:2] + ring, np.ones(_TRUNK_SIDES)
        low, high = (np.column_stack([circle, z * ones]) for z in (foot[2], top))
        meshes.append(Mesh(np.concatenate([low, high, [[*foot[:2], top]]]), faces))
    return ScenePart(SolidField(lambda p: find(p)[0], gradient), join_meshes(meshes), VEGETATION)


def make_boxes(boxes: Sequence[Box]) -> ScenePart:
    """Return axis-parallel boxes, each filled or cut out of those before it.

    The outermost faces, which nobody sees from inside, are left out of the mesh.
    """
    field = _box(boxes[0])
    for each in boxes[1:]:
        field = unite(field, _box(each)) if each[2] else cut(field, _box(each))
    # (k,) for each axis: all coordinates; (k - 1, l - 1, m - 1): whether each cell is solid
    corners = np.round([corner for each in boxes for corner in each[:2]], 9)
    lines = [np.unique(corners[:, axis]) for axis in range(3)]
    middles = np.meshgrid(*(0.5 * (line[1:] + line[:-1]) for line in lines), indexing="ij")
    cells = field.value(np.stack(middles, axis=-1).reshape(-1, 3)) < 0.0
    is_solid = cells.reshape(middles[0].shape)
    number = np.arange(np.prod([len(line) for line in lines])).reshape([len(x) for x in lines])
    quads = []
    for axis in range(3):
        solid, node = np.moveaxis(is_solid, axis, 0), np.moveaxis(number, axis, 0)
        level, j, k = np.nonzero(solid[1:] != solid[:-1])
        level += 1
        around = [(j, k), (j + 1, k), (j + 1, k + 1), (j, k + 1)]
        quad = np.stack([node[level, row, column] for row, column in around], axis=1)
        # moving the middle axis to the front mirrors the other two
        turned = solid[level, j, k] ^ (axis == 1)
        quads.append(np.where(turned[:, None], quad[:, ::-1], quad))
    quad = np.concatenate(quads)
    used, faces = np.unique(np.concatenate([quad[:, :3], quad[:, [0, 2, 3]]]), return_inverse=True)
    nodes = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    return ScenePart(field, Mesh(nodes[used], faces.reshape(-1, 3)), OTHER)


def make_model(shape: Solid) -> ScenePart:
    """Return an analytic model; its mesh has vertices on the surface, edges cut off by a cell."""
    from skimage import measure  # heavy

    low, high = shape.bounds
    step = diagonal_of(shape) / _MODEL_CELLS
    axes = [np.arange(a - 2.0 * step, b + 2.0 * step, step) for a, b in zip(low, high, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    values = np.concatenate(run_in_blocks(lambda part: shape.value(nodes[part]), len(nodes)))
    marching_cubes: Any = measure.marching_cubes  # without type hints
    vertices, faces, _, _ = marching_cubes(
        values.reshape([len(axis) for axis in axes]), level=0.0, gradient_direction="descent"
    )
    start = np.array([axis[0] for axis in axes])
    feet, _ = fall(shape, start + step * vertices.astype(np.float64))
    return ScenePart(
        SolidField(shape.value, shape.gradient), Mesh(feet, faces.astype(np.int64)), OTHER
    )


def join_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Return one mesh of several that share no vertex."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def _box(each: Box) -> SolidField:
    low, high = np.array(each[0]), np.array(each[1])
    return box(0.5 * (low + high), 0.5 * (high - low))


def _convex(vertices: FloatArray, faces: IntArray) -> SolidField:
    """Return a convex solid from its faces, open where it has none: exact inside."""
    normals = cross_edges(vertices[faces])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.einsum("ij,ij->i", normals, vertices[faces[:, 0]])

    def heights(points: FloatArray) -> FloatArray:
        above: FloatArray = np.einsum("ij,kj->ik", points, normals) - offsets
        return above

    return SolidField(
        lambda points: heights(points).max(axis=1),
        lambda points: normals[heights(points).argmax(axis=1)],
    )
