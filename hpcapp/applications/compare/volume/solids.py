"""The change of the volume that a closed mesh encloses."""

from __future__ import annotations

import numpy as np

from hpcapp.applications.compare.truth import MeshTruth
from hpcapp.applications.compare.volume.measure import SolidChange, Volume, name_shift
from hpcapp.applications.surface.stitching.topology import signed_volume, surface_area
from hpcapp.geometry.lattice import pack_places
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.io.points.mesh_samples import sample_faces
from hpcapp.terrain.errors import LIKELY, STAYED, find_registration

_SAMPLES = 10_000  # of the new surface: an offset is known to a hundredth of the noise
_SWOLLEN = 0.085
"""Widths of a face that noise, which a mesh does not tell, lifts its surface by: .008 at most where
it is below a fifth of the spacing of the points, .01 to .12 in 11 of 12 piles above
(`benchmarks/volumes.py`)."""
_FEWEST_BLOCKS = 30  # whose sums tell a variance to a quarter


def measure_solids(new: Mesh, old: Mesh, registration: float | None) -> SolidChange:
    """Measure how much more the new one of two closed meshes encloses; both face outwards.

    Where one of them lies does not matter to what it encloses, but how finely it was meshed does,
    and how far all of its surface lies outside of the other one where nothing changed.
    """
    volumes = [
        Volume(signed_volume(mesh), find_resolution(mesh), 0.0, surface_area(mesh))
        for mesh in (new, old)
    ]
    cloud = sample_faces(new, _SAMPLES)
    assert cloud.normals is not None  # noqa: S101 - faces have some
    truth = MeshTruth(old)
    sides = truth.find_sides(cloud.positions)
    assert sides is not None  # noqa: S101 - it is closed
    change = sides * truth.distance(cloud.positions)
    effect = np.column_stack([cloud.normals, np.ones(_SAMPLES)])
    unknown = np.full(len(effect[0]), np.inf)
    lie = find_registration(change, effect, np.zeros(_SAMPLES), unknown, registration)
    residual = (change - effect @ lie.shift)[lie.stayed]
    noise = float(residual.std()) if len(residual) else 0.0
    offset = volumes[0].area * float(abs(lie.bias[3]))
    net = Volume(
        volumes[0].volume - volumes[1].volume,
        volumes[0].uncertainty + volumes[1].uncertainty + offset
        + LIKELY * _find_deviation(residual, cloud.positions[lie.stayed], volumes[0].area),
        offset,
        volumes[0].area,
    )  # fmt: skip
    return SolidChange(
        volumes[0], volumes[1], net, name_shift(lie.shift), float(lie.shift[3]), registration,
        noise, STAYED * noise,
    )  # fmt: skip


def find_resolution(mesh: Mesh) -> float:
    """Return by how much the volume of a closed mesh is uncertain by itself.

    By what it loses when each vertex goes to the mean of its neighbours: what is cut off from bends
    and edges once more, as it was when the surface was meshed; at least by what noise may add.
    """
    tails, heads = mesh.faces.ravel(), mesh.faces[:, [1, 2, 0]].ravel()
    degree = np.maximum(np.bincount(tails, minlength=len(mesh.vertices)), 1)
    means = [np.bincount(tails, axis[heads], len(degree)) / degree for axis in mesh.vertices.T]
    smoothed = Mesh(np.stack(means, axis=1), mesh.faces)
    area = surface_area(mesh)
    swollen = _SWOLLEN * area * float(np.sqrt(area / len(mesh.faces)))
    return max(abs(signed_volume(mesh) - signed_volume(smoothed)), swollen)


def _find_deviation(residual: FloatArray, places: FloatArray, area: float) -> float:
    """Return the standard deviation of the volume of noise: of blocks of the width that shows most.

    Residuals (n,) are at places (n, 3) of a surface of this area.
    """
    most, width = 0.0, float(np.sqrt(area / _SAMPLES))
    while len(residual):
        keys = pack_places(np.floor(places / width).astype(np.int64))
        sums = np.bincount(np.unique(keys, return_inverse=True)[1], residual)
        if most and len(sums) < _FEWEST_BLOCKS:
            break
        most = max(most, float((sums**2).sum()) / len(residual))
        width *= 2.0
    return area * float(np.sqrt(most / _SAMPLES))
