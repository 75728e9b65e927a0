"""How far a mesh is from the truth: python benchmarks/metrics.py MESH --shape knot | --truth MESH.

Distances are in per cent of the diagonal of the truth's bounding box. The truth is an analytic
shape (its surface is exact) or a mesh.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from nearest import NearestFace, face_normals
from scipy.spatial import KDTree

from hpcapp.applications.simulate.rays import closest_points
from hpcapp.applications.simulate.scanner import sample_surface
from hpcapp.applications.simulate.shapes import SHAPES, Shape, diagonal_of, find_shape
from hpcapp.applications.surface.stitching.topology import Topology, check_mesh
from hpcapp.io import read_mesh
from hpccomponent.surface.kernels import bound_points
from hpccomponent.surface.types.mesh import Mesh
from hpccomponent.surface.types.points import FloatArray, PointCloud

__all__ = ["Measures", "MeshTruth", "ShapeTruth", "Truth", "measure_mesh", "sample_mesh"]

F_THRESHOLDS = (0.02, 0.1, 0.5)  # per cent of the diagonal


class Truth(Protocol):
    """A surface to compare with."""

    @property
    def diagonal(self) -> float:
        """Return the diagonal of its bounding box, in length units."""
        ...

    @property
    def is_closed(self) -> bool:
        """Tell whether it has no holes: where it has some, only completeness means anything."""
        ...

    def sample(self, count: int, seed: int) -> PointCloud:
        """Return points spread evenly over it, with its normals."""
        ...

    def distance(self, points: FloatArray) -> FloatArray:
        """Return each point's distance to it, shape (n,), in length units."""
        ...


@dataclass(frozen=True, slots=True)
class Measures:
    """A mesh against the truth; lengths in per cent of the truth's diagonal.

    Parameters
    ----------
    accuracy : float
        Mean distance from the mesh to the truth; NaN where the truth is open.
    completeness : float
        Mean distance from the truth to the mesh.
    l1 : float
        Mean of the two; the completeness where the truth is open.
    rms : float
        Root of the mean square of both directions' distances together.
    hausdorff : float
        Largest distance met in either direction.
    f_scores : dict of str to float
        Harmonic mean of precision and recall, by threshold in per cent.
    normal_deg : float
        Mean angle between the truth's normal and that of the nearest face, in degrees.
    topology : Topology
        Of the mesh.
    """

    accuracy: float
    completeness: float
    l1: float
    rms: float
    hausdorff: float
    f_scores: dict[str, float]
    normal_deg: float
    topology: Topology


class ShapeTruth:
    """An analytic shape as the truth.

    Parameters
    ----------
    shape : Shape
    """

    is_closed = True

    def __init__(self, shape: Shape) -> None:
        self.shape = shape
        self.diagonal = diagonal_of(shape)
        self._guesses = sample_surface(shape, 50_000, seed=1).positions
        self._tree = KDTree(self._guesses)

    def sample(self, count: int, seed: int) -> PointCloud:
        """Return exact points of the surface; see `Truth.sample`."""
        return sample_surface(self.shape, count, seed)

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the distances to the surface; see `Truth.distance`."""
        guesses = self._guesses[self._tree.query(points)[1]]
        feet = closest_points(self.shape, points, guesses, rounds=3)
        lengths: FloatArray = np.linalg.norm(points - feet, axis=1)
        return lengths


class MeshTruth:
    """A mesh as the truth.

    Parameters
    ----------
    mesh : Mesh
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self._faces = NearestFace(mesh)
        low, high = bound_points(mesh.vertices[np.unique(mesh.faces)])
        self.diagonal = float(np.linalg.norm(high - low))
        self.is_closed = check_mesh(mesh).boundary_edges == 0

    def sample(self, count: int, seed: int) -> PointCloud:
        """Return points of the faces; see `Truth.sample`."""
        return sample_mesh(self.mesh, count, seed)

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the distances to the faces; see `Truth.distance`."""
        return self._faces.query(points)[0]


def measure_mesh(mesh: Mesh, truth: Truth, samples: int = 50_000, seed: int = 0) -> Measures:
    """Compare a mesh with the truth.

    Parameters
    ----------
    mesh : Mesh
        In the frame of the truth.
    truth : Truth
    samples : int
        Points on either surface, spread evenly over its area.
    seed : int

    Returns
    -------
    Measures
    """
    percent = 100.0 / truth.diagonal
    wanted = truth.sample(samples, seed)
    backward, faces = NearestFace(mesh).query(wanted.positions)
    backward *= percent
    if truth.is_closed:
        forward = percent * truth.distance(sample_mesh(mesh, samples, seed).positions)
    else:
        forward = np.empty(0)
    both = np.concatenate([forward, backward])
    accuracy = float(forward.mean()) if truth.is_closed else float("nan")
    completeness = float(backward.mean())
    assert wanted.normals is not None
    cosine = np.einsum("ij,ij->i", wanted.normals, face_normals(mesh)[faces])
    return Measures(
        accuracy,
        completeness,
        0.5 * (accuracy + completeness) if truth.is_closed else completeness,
        float(np.sqrt((both**2).mean())),
        float(both.max()),
        {f"{t:g}": _f_score(forward, backward, t) for t in F_THRESHOLDS},
        float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).mean()),
        check_mesh(mesh),
    )


def sample_mesh(mesh: Mesh, count: int, seed: int = 0) -> PointCloud:
    """Return points spread evenly over the faces of a mesh, with the faces' normals.

    Parameters
    ----------
    mesh : Mesh
        With at least one face of positive area.
    count : int
    seed : int

    Returns
    -------
    PointCloud
    """
    rng = np.random.default_rng(seed)
    area = np.linalg.norm(_face_crosses(mesh), axis=1)
    # Equal steps through the summed areas: fewer clumps than independent draws.
    steps = (np.arange(count) + rng.random(count)) / count
    total = np.cumsum(area)
    face = np.minimum(np.searchsorted(total, steps * total[-1]), len(area) - 1)
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    a, b, c = (mesh.vertices[mesh.faces[face, k]] for k in range(3))
    return PointCloud(a + u * (b - a) + v * (c - a), face_normals(mesh)[face])


def _face_crosses(mesh: Mesh) -> FloatArray:
    """Return twice the area vector of every face."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _f_score(forward: FloatArray, backward: FloatArray, threshold: float) -> float:
    """Return the harmonic mean of precision and recall; recall alone where the truth is open."""
    recall = float((backward <= threshold).mean())
    if not len(forward):
        return recall
    precision = float((forward <= threshold).mean())
    return 2.0 * precision * recall / max(precision + recall, 1e-12)


def read_global_mesh(path: Path) -> Mesh:
    """Read a mesh in the coordinates of its file."""
    mesh = read_mesh(path)
    return Mesh(mesh.vertices + mesh.origin, mesh.faces)


def as_json(measures: Measures) -> dict[str, Any]:
    """Return measures as plain values; NaN becomes None, which JSON knows."""
    plain = asdict(measures)
    if np.isnan(measures.accuracy):
        plain["accuracy"] = None
    return plain


def main() -> None:
    """Measure one mesh and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh", type=Path)
    against = parser.add_mutually_exclusive_group(required=True)
    against.add_argument("--shape", choices=sorted(SHAPES), help="an analytic shape")
    against.add_argument("--truth", type=Path, help="a mesh")
    parser.add_argument("--samples", type=int, default=50_000)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    truth: Truth = (
        ShapeTruth(find_shape(args.shape))
        if args.shape
        else MeshTruth(read_global_mesh(args.truth))
    )
    found = as_json(measure_mesh(read_global_mesh(args.mesh), truth, args.samples))
    if args.json:
        print(json.dumps(found))
        return
    for name, value in found.items():
        print(f"{name:14} {value:.5f}" if isinstance(value, float) else f"{name:14} {value}")


if __name__ == "__main__":
    main()
