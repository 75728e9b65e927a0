"""Closed meshes whose difference is known."""

from __future__ import annotations

import numpy as np
import pytest
from level_sets import mesh_level_set
from skimage.measure import marching_cubes

import hpcapp
from hpcapp.applications.compare.volume.measure import SolidChange
from hpccomponent.errors import InputError, UsageError

CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
])  # fmt: skip
FAR = np.array([4e5, 5e6, 0.0])


TRUE = {"bracket": 99_470.0, "knot": 1_927.0, "box": 1.6967, "flange": 150_764.0}
"""Volumes of the shapes, by a grid of 160 and of 80 cells."""


def block() -> hpcapp.Mesh:
    return hpcapp.Mesh(CORNERS + FAR, FACES)


def ball(radius: float, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> hpcapp.Mesh:
    mesh = mesh_level_set(lambda *place: np.linalg.norm(place, axis=0) - 1.0, 1.3, 50)
    lengths = np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    return hpcapp.Mesh(at + radius * mesh.vertices / lengths, mesh.faces)


def measure(new: hpcapp.Mesh, old: hpcapp.Mesh, registration: float | None = None) -> SolidChange:
    change = hpcapp.compare_epochs(new, old, registration=registration)
    assert isinstance(change, SolidChange)
    return change


def mesh_scan(shape: str, grid: int, noise: float = 0.001, seed: int = 0) -> hpcapp.Mesh:
    scan = hpcapp.simulate(shape, points=20_000, noise=noise, seed=seed)
    return hpcapp.reconstruct(scan, grid=grid)


def add_block(mesh: hpcapp.Mesh, side: float) -> hpcapp.Mesh:
    """Return a mesh, and a block of fine faces beside it."""
    value = np.pad(np.ones((14, 14, 14)), 1)
    # scikit-image has no types
    vertices, faces, _, _ = marching_cubes(value, 0.5)  # type: ignore[no-untyped-call]
    place = mesh.bounds[1] + side + (vertices - vertices.mean(axis=0)) * side / 14.0
    return hpcapp.Mesh(
        np.concatenate([mesh.vertices, place]),
        np.concatenate([mesh.faces, faces[:, ::-1] + len(mesh.vertices)]),
    )


def test_one_scan_meshed_at_two_grids_has_not_changed() -> None:
    for shape in ("bracket", "knot"):
        fine, coarse = mesh_scan(shape, 64), mesh_scan(shape, 48)
        for new, old in ((fine, coarse), (coarse, fine)):
            change = measure(new, old)
            assert not change.net.is_significant
            assert change.net.uncertainty < 0.12 * change.old.volume


def test_two_scans_with_other_noise_have_not_changed() -> None:
    change = measure(mesh_scan("bracket", 64, 0.006, seed=1), mesh_scan("bracket", 64))
    assert not change.net.is_significant
    assert change.offset > 0.02  # noise makes walls thicker


def test_what_was_added_is_told() -> None:
    old = mesh_scan("bracket", 64)
    side = 0.5 * old.volume ** (1.0 / 3.0)
    change = measure(add_block(mesh_scan("bracket", 64, seed=1), side), old)
    assert change.net.is_significant
    assert abs(change.net.volume - side**3) < change.net.uncertainty < 0.7 * side**3


@pytest.mark.parametrize("shape", ["bracket", "knot", "box"])
@pytest.mark.parametrize("grid", [40, 56])
def test_a_volume_is_within_what_the_width_of_faces_makes_of_it(shape: str, grid: int) -> None:
    change = measure(mesh_scan(shape, grid), mesh_scan(shape, grid, seed=1))
    assert abs(change.new.volume - TRUE[shape]) < change.new.uncertainty
    assert change.new.uncertainty < 0.12 * change.new.volume


def test_walls_as_thin_as_a_cell_take_half_of_what_is_said() -> None:
    """A third of it would not hold the error, and double of it would be of no use."""
    change = measure(mesh_scan("flange", 40, 0.0), mesh_scan("flange", 40, 0.0))
    off = abs(change.new.volume - TRUE["flange"])
    assert 0.4 * change.new.uncertainty < off < 0.9 * change.new.uncertainty


def test_where_a_mesh_lies_does_not_matter() -> None:
    old = ball(1.0)
    for new in (ball(1.0, (0.02, -0.01, 0.03)), hpcapp.Mesh(old.vertices, old.faces[:, ::-1])):
        change = measure(new, old)
        assert change.shift == pytest.approx(new.vertices.mean(axis=0), abs=2e-3)
        assert change.net.volume == pytest.approx(0.0, abs=1e-9)
        assert not change.net.is_significant
        assert change.net.area == pytest.approx(4.0 * np.pi, rel=0.01)


def test_swelling_all_over_is_uncertain_unless_the_user_vouches() -> None:
    old, new = ball(1.0), ball(1.05)
    swelling = 4.0 / 3.0 * np.pi * (1.05**3 - 1.0)
    doubted, sure = measure(new, old), measure(new, old, 0.0)
    assert doubted.offset == pytest.approx(0.05, abs=0.002)
    assert not doubted.net.is_significant
    assert sure.net.is_significant
    assert sure.net.volume == pytest.approx(swelling, rel=0.01)
    assert sure.net.from_shift == 0.0


def test_what_does_not_fit_is_refused() -> None:
    solid = block()
    for other in (hpcapp.Mesh(solid.vertices, FACES[2:]), np.random.default_rng(0).random((99, 3))):
        for epochs in ((solid, other), (other, solid)):
            with pytest.raises(InputError, match="is a closed mesh and"):
                hpcapp.compare_epochs(*epochs)
    with pytest.raises(UsageError, match="no cells"):
        hpcapp.compare_epochs(solid, solid, cell=0.1)
