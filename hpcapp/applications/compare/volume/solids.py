"""The change of the volume that a closed mesh encloses."""

from __future__ import annotations

import numpy as np

from hpcapp.applications.compare.truth import MeshTruth, sample_mesh
from hpcapp.applications.compare.volume.errors import Samples, find_errors
from hpcapp.applications.compare.volume.measure import SolidChange, Volume, name_shift
from hpcapp.applications.surface.stitching.topology import signed_volume, surface_area
from hpcapp.geometry.mesh import Mesh

_SAMPLES = 10_000  # of the new surface: an offset is known to a hundredth of the noise


def measure_solids(new: Mesh, old: Mesh, registration: float | None) -> SolidChange:
    """Measure how much more the new one of two closed meshes encloses; both face outwards.

    Where one of them lies does not matter to what it encloses, but how finely it was meshed does,
    and how far all of its surface lies outside of the other one where nothing changed.

    Parameters
    ----------
    registration : float, optional
        See `find_errors`.
    """
    volumes = [
        Volume(signed_volume(mesh), find_resolution(mesh), 0.0, surface_area(mesh))
        for mesh in (new, old)
    ]
    samples = _sample_change(new, old, volumes[0].area / _SAMPLES)
    errors = find_errors(samples, registration)
    offset = volumes[0].area * float(abs(errors.bias[3]))
    noise = errors.sum_noise(samples, np.arange(_SAMPLES))
    net = Volume(
        volumes[0].volume - volumes[1].volume,
        volumes[0].uncertainty + volumes[1].uncertainty + offset + noise,
        offset,
        volumes[0].area,
    )
    return SolidChange(
        volumes[0], volumes[1], net, name_shift(errors.shift), float(errors.shift[3]),
        registration, errors.noise, float(np.median(errors.detect(samples))),
    )  # fmt: skip


def find_resolution(mesh: Mesh) -> float:
    """Return by how much the width of its faces makes the volume of a closed mesh uncertain.

    That is what it loses when each vertex goes to the mean of its neighbours: what is cut off from
    bends and edges once more, as it was when the surface was meshed.
    """
    tails, heads = mesh.faces.ravel(), mesh.faces[:, [1, 2, 0]].ravel()
    degree = np.maximum(np.bincount(tails, minlength=len(mesh.vertices)), 1)
    means = [np.bincount(tails, axis[heads], len(degree)) / degree for axis in mesh.vertices.T]
    smoothed = Mesh(np.stack(means, axis=1), mesh.faces)
    return abs(signed_volume(mesh) - signed_volume(smoothed))


def _sample_change(new: Mesh, old: Mesh, area: float) -> Samples:
    """Return how far the new surface is in front of the old one."""
    cloud = sample_mesh(new, _SAMPLES)
    assert cloud.normals is not None  # noqa: S101 - faces have some
    truth = MeshTruth(old)
    sides = truth.find_sides(cloud.positions)
    assert sides is not None  # noqa: S101 - it is closed
    return Samples(
        sides * truth.distance(cloud.positions),
        np.column_stack([cloud.normals, np.ones(_SAMPLES)]),
        cloud.positions / np.sqrt(area), area, np.ones(_SAMPLES), np.zeros(_SAMPLES),
    )  # fmt: skip
