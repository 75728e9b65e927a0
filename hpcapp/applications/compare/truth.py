"""What a mesh is compared with: another mesh, points, or a shape whose surface is known."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.spatial import KDTree

from hpcapp.applications.compare.nearest import ROUNDING, NearestFace
from hpcapp.applications.compare.sides import find_sides
from hpcapp.applications.surface.stitching.topology import Topology, check_mesh
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import holds_faces, open_points, read_mesh, read_points, take_finite
from hpcapp.io.points.mesh_samples import sample_faces
from hpcapp.io.usable_mesh import check_usable
from hpcapp.lab.simulate.implicit import Solid, diagonal_of
from hpcapp.lab.simulate.rays import closest_points
from hpcapp.lab.simulate.scanner import sample_surface
from hpcapp.lab.simulate.shapes import find_shape
from hpcapp.named_files import SHAPE
from hpccomponent.errors import InputError

_GUESSES = 50_000  # points on a shape, from which its nearest one is sought


class Truth(Protocol):
    """A surface to compare with."""

    @property
    def diagonal(self) -> float:
        """The diagonal of its bounding box, in length units."""
        ...

    @property
    def is_closed(self) -> bool:
        """Whether it has no holes: where it has some, only completeness means anything."""
        ...

    @property
    def unit(self) -> str:
        """Of length; nothing where it is not known."""
        ...

    def sample(self, count: int, seed: int) -> PointCloud:
        """Return points spread evenly over it, with its normals where they are known."""
        ...

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the distance of points (n, 3) to it, (n,), in length units."""
        ...

    def find_sides(self, points: FloatArray) -> FloatArray | None:
        """Return 1 for points (n, 3) outside of it, -1 inside; None where it has no sides."""
        ...


class ShapeTruth:
    """An analytic shape as the truth; see `Truth`."""

    is_closed = True
    unit = ""

    def __init__(self, shape: Solid) -> None:
        self.shape = shape
        self.diagonal = diagonal_of(shape)
        self._guesses = sample_surface(shape, _GUESSES, seed=1).positions
        self._tree = KDTree(self._guesses)

    def sample(self, count: int, seed: int) -> PointCloud:
        """Return exact points of the surface."""
        return sample_surface(self.shape, count, seed)

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the distances to the surface."""
        guesses = self._guesses[self._tree.query(points, eps=ROUNDING)[1]]
        feet = closest_points(self.shape, points, guesses, rounds=3)
        lengths: FloatArray = np.linalg.norm(points - feet, axis=1)
        return lengths

    def find_sides(self, points: FloatArray) -> FloatArray:
        """Return the sign of the shape's own function."""
        return np.where(self.shape.value(points) < 0.0, -1.0, 1.0)


class MeshTruth:
    """A mesh with at least one face as the truth."""

    unit = ""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self._faces = NearestFace(mesh)
        low, high = bound_points(mesh.vertices[np.unique(mesh.faces)])
        self.diagonal = float(np.linalg.norm(high - low))

    @cached_property
    def _topology(self) -> Topology:
        return check_mesh(self.mesh)

    @property
    def is_closed(self) -> bool:
        """Whether no edge has only one face."""
        return self._topology.boundary_edges == 0

    def sample(self, count: int, seed: int) -> PointCloud:
        """Return points of the faces."""
        return sample_faces(self.mesh, count, seed)

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the distances to the faces."""
        return self._faces.query(points)[0]

    def find_sides(self, points: FloatArray) -> FloatArray | None:
        """Return the sides of a closed mesh whose faces agree; of others none are known."""
        if not (self._topology.watertight and self._topology.oriented):
            return None
        sides = find_sides(self.mesh, points, self._faces.query(points)[1])
        return sides if self._topology.outward else -sides


class PointTruth:
    """Points as the truth: at least one, all finite; their unit is "" where it is not known.

    A distance to points is that to the nearest: at best as small as their spacing and noise.
    """

    is_closed = True  # what lies far from all points counts

    def __init__(self, cloud: PointCloud, unit: str = "") -> None:
        self.cloud = cloud
        self.unit = unit
        self._tree = KDTree(cloud.positions)
        low, high = bound_points(cloud.positions)
        self.diagonal = float(np.linalg.norm(high - low))

    def sample(self, count: int, seed: int) -> PointCloud:
        """Return some of the points, or all of them where there are fewer."""
        if len(self.cloud) <= count:
            return self.cloud
        rows = np.random.default_rng(seed).choice(len(self.cloud), count, replace=False)
        return self.cloud.take(np.sort(rows))

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the distances to the nearest points."""
        lengths: FloatArray = self._tree.query(points, eps=ROUNDING)[0]
        return lengths

    def find_sides(self, points: FloatArray) -> FloatArray | None:
        """Return the sides by the normals of the nearest points; None without normals."""
        if self.cloud.normals is None:
            return None
        nearest = self._tree.query(points)[1]
        arms = points - self.cloud.positions[nearest]
        return np.where(np.einsum("ij,ij->i", arms, self.cloud.normals[nearest]) < 0.0, -1.0, 1.0)


def open_truth(name: str, origin: FloatArray) -> Truth:
    """Open a mesh, points, or ``shape:NAME`` as the truth, in the frame of an origin (3,).

    A file that holds faces is a mesh. Raise InputError where it cannot be read, or holds nothing to
    compare with, and UsageError where the suffix or the shape is unknown.
    """
    if name.startswith(SHAPE):
        if origin.any():
            raise InputError(
                "a mesh with coordinates far from zero is none of a shape", "compare it with a file"
            )
        return ShapeTruth(find_shape(name.removeprefix(SHAPE)))
    path = Path(name)
    if holds_faces(path):
        return MeshTruth(read_mesh_at(path, origin))
    cloud = take_finite(read_points(path), name)
    unit = open_points(path).unit or ""
    return PointTruth(replace(cloud, positions=cloud.positions + (cloud.origin - origin)), unit)


def read_mesh_at(path: Path, origin: FloatArray | None = None) -> Mesh:
    """Read a mesh in the frame of an origin (3,) in the file's coordinates, by default zero.

    Raise InputError where it cannot be read, or `check_usable` refuses it.
    """
    mesh = read_mesh(path)
    check_usable(mesh, path)
    target = np.zeros(3) if origin is None else origin
    return replace(mesh, vertices=mesh.vertices + (mesh.origin - target), origin=target)
