"""Holes that are cut into surfaces that are known, and filled."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from crossings import count_crossings
from cut_mesh import ball, extract_shape, torus
from shared_data import shared

from hpcapp.applications.compare.nearest import NearestFace
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray
from hpcapp.io import read_mesh
from hpcapp.mending import loops
from hpcapp.mending.holes import fill_holes
from hpcapp.mending.pieces import keep_faces

RADIUS = 0.6


@cache
def make_ball() -> Mesh:
    return extract_shape(lambda points: ball(points, (0.0, 0.0, 0.0), RADIUS))[0]


def below(mesh: Mesh, height: float) -> BoolArray:
    stays: BoolArray = mesh.vertices[mesh.faces][:, :, 2].max(axis=1) < height
    return stays


def make_sheet(side: int = 20) -> Mesh:
    """A square of that many cells, each of two triangles."""
    i, j = (each.ravel() for each in np.meshgrid(*[np.arange(side)] * 2, indexing="ij"))
    a = (i * (side + 1) + j)[:, None] + np.array([0, side + 1, side + 2, 1])
    faces = np.concatenate([a[:, :3], a[:, [0, 2, 3]]])
    x, y = (each.ravel() for each in np.meshgrid(*[np.arange(side + 1)] * 2, indexing="ij"))
    return Mesh(np.stack([x, y, 0 * x], axis=1).astype(float), faces)


@pytest.mark.parametrize(
    ("height", "error"), [(0.55, 0.003), (0.5, 0.003), (0.4, 0.02), (0.28, 0.06)]
)
def test_a_cap_of_a_ball_comes_back(height: float, error: float) -> None:
    """A flat lid would be off by up to 0.05, 0.1, 0.2 and 0.32."""
    mesh = make_ball()
    holed = keep_faces(mesh, below(mesh, height))
    filled = fill_holes(holed, 2.0)
    assert (filled.holes, filled.left) == (1, 0)
    topology = check_mesh(filled.mesh)
    assert topology.watertight
    assert topology.oriented
    assert topology.outward
    assert topology.genus == 0
    radii = np.linalg.norm(filled.mesh.vertices[len(holed.vertices) :], axis=1)
    assert np.abs(radii - RADIUS).max() < error
    assert np.array_equal(filled.mesh.vertices[: len(holed.vertices)], holed.vertices)
    assert np.array_equal(filled.mesh.faces[: len(holed.faces)], holed.faces)
    assert not count_crossings(filled.mesh, len(holed.faces))
    assert _is_even(filled.mesh, len(holed.faces))


def _is_even(mesh: Mesh, first: int) -> bool:
    """Tell whether new faces are about as large as the old ones."""
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return bool(0.5 < np.median(areas[first:]) / np.median(areas[:first]) < 4.0)


def test_holes_all_over_a_ring_are_filled_at_once() -> None:
    mesh = extract_shape(torus)[0]
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    angles = np.arange(6) * np.pi / 3.0
    centres = np.stack([0.76 * np.cos(angles), 0.76 * np.sin(angles), 0.0 * angles], axis=1)
    far = np.linalg.norm(middles[:, None] - centres, axis=2).min(axis=1)
    holed = keep_faces(mesh, far > 0.12)
    assert check_mesh(holed).boundaries == 6
    filled = fill_holes(holed, 1.0)
    assert filled.holes == 6
    topology = check_mesh(filled.mesh)
    assert topology.watertight
    assert topology.genus == 1
    new = filled.mesh.vertices[len(holed.vertices) :]
    ring = np.hypot(np.hypot(new[:, 0], new[:, 1]) - 0.55, new[:, 2]) - 0.21
    assert np.abs(ring).max() < 0.012
    assert not count_crossings(filled.mesh, len(holed.faces))


def test_only_holes_up_to_the_size_are_filled() -> None:
    mesh = make_ball()
    lower = mesh.vertices[mesh.faces][:, :, 2].min(axis=1) > -0.5
    holed = keep_faces(mesh, below(mesh, 0.55) & lower)
    widths = 2.0 * np.sqrt(2.0) * np.sqrt(RADIUS**2 - np.array([0.55, 0.5]) ** 2)
    filled = fill_holes(holed, float(widths.mean()))
    assert filled.holes == 1
    assert check_mesh(filled.mesh).boundaries == 1
    assert fill_holes(filled.mesh, 2.0).holes == 1


def test_the_end_of_a_sheet_is_no_hole() -> None:
    sheet = make_sheet()
    middles = sheet.vertices[sheet.faces].mean(axis=1)
    holed = keep_faces(sheet, np.linalg.norm(middles - (10.0, 10.0, 0.0), axis=1) > 4.0)
    filled = fill_holes(holed, 1000.0)
    assert filled.holes == 1
    assert check_mesh(filled.mesh).boundaries == 1
    a, b, c = filled.mesh.vertices[filled.mesh.faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    assert (normals[:, 2] > 0.0).all()
    assert 0.5 * normals[:, 2].sum() == pytest.approx(400.0)


@pytest.mark.parametrize(
    ("height", "factor", "holes"),
    [
        # what a plane at this height spans is 0.38 of the area below it
        (0.16, 0.5, 0), (0.16, 0.9, 1), (0.16, 1.0, 1), (0.16, 1.1, 1),
        # here it is 0.66
        (-0.18, 2.0, 1), (-0.18, 1.1, 0), (-0.18, 1.0, 0), (-0.18, 0.9, 0),
    ],
)  # fmt: skip
def test_what_shows_more_than_half_of_an_object_has_a_hole_and_less_is_a_sheet(
    monkeypatch: pytest.MonkeyPatch, height: float, factor: float, holes: int
) -> None:
    mesh = make_ball()
    monkeypatch.setattr(loops, "SHEET", factor * loops.SHEET)
    assert fill_holes(keep_faces(mesh, below(mesh, height)), 2.0).holes == holes


def test_where_no_face_can_join_a_border_stays() -> None:
    """Two holes that touch at a vertex, and a fin on a hole's border."""
    sheet = make_sheet()
    middles = sheet.vertices[sheet.faces].mean(axis=1)

    def far(x: float, y: float) -> BoolArray:
        stays: BoolArray = np.abs(middles - (x, y, 0.0)).max(axis=1) > 1.0
        return stays

    touching = keep_faces(sheet, far(5.0, 5.0) & far(7.0, 7.0) & far(14.0, 14.0))
    filled = fill_holes(touching, 6.0)
    assert (filled.holes, filled.left) == (1, 1)
    assert check_mesh(filled.mesh).edge_manifold
    hole = keep_faces(sheet, far(14.0, 14.0))
    loop = loops.find_holes(hole, 6.0).holes[0]
    # An edge from the border into the surface gets a third face.
    at_border = np.isin(hole.faces, loop)
    face = hole.faces[np.flatnonzero(at_border.sum(axis=1) == 1)[0]]
    start, end = face[np.isin(face, loop)][0], face[~np.isin(face, loop)][0]
    fin = Mesh(
        np.concatenate([hole.vertices, [[14.0, 14.0, 3.0]]]),
        np.concatenate([hole.faces, [[start, end, len(hole.vertices)]]]),
    )
    filled = fill_holes(fin, 6.0)
    assert (filled.holes, filled.left) == (0, 1)


def test_one_face_is_no_hole() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    assert not fill_holes(Mesh(corners, np.array([[0, 1, 2]])), 9.0).holes


def test_what_vertices_carry_goes_on() -> None:
    mesh = make_ball()
    right = mesh.vertices[:, 0] > 0.0
    whole = Mesh(
        mesh.vertices, mesh.faces, np.array([4e5, 5e6, 0.0]), mesh.vertices / RADIUS,
        np.where(right[:, None], 200, 10).astype(np.uint8) * np.ones(3, np.uint8),
        {"class": right.astype(np.uint16)},
    )  # fmt: skip
    holed = keep_faces(whole, below(whole, 0.5))
    filled = fill_holes(holed, 2.0).mesh
    new = slice(len(holed.vertices), None)
    assert filled.normals is not None
    assert filled.colours is not None
    out: FloatArray = filled.vertices[new] / RADIUS
    assert (np.einsum("ij,ij->i", filled.normals[new], out) > 0.97).all()
    assert filled.attributes["class"].dtype == np.uint16
    is_far = np.abs(filled.vertices[new, 0]) > 0.05
    is_right = filled.vertices[new, 0] > 0.0
    assert ((filled.attributes["class"][new] == 1) == is_right)[is_far].all()
    assert ((filled.colours[new, 0] == 200) == is_right)[is_far].all()
    assert filled.origin.tolist() == [4e5, 5e6, 0.0]


def test_the_holes_below_a_bunny() -> None:
    bunny = read_mesh(shared("bunny_zipper_mesh.ply"))
    filled = fill_holes(bunny, 0.2)
    assert (filled.holes, filled.left) == (5, 0)
    assert check_mesh(filled.mesh).watertight
    assert not count_crossings(filled.mesh, len(bunny.faces))


def test_holes_of_an_object_come_nearer_than_lids() -> None:
    whole = read_mesh(shared("rocker_arm_mesh.ply"))
    diagonal = float(np.linalg.norm(np.ptp(whole.vertices, axis=0)))
    middles = whole.vertices[whole.faces].mean(axis=1)
    centres = middles[np.random.default_rng(1).choice(len(middles), 8, replace=False)]
    far = np.linalg.norm(middles[:, None] - centres, axis=2).min(axis=1)
    holed = keep_faces(whole, far > 0.025 * diagonal)
    filled = fill_holes(holed, diagonal)
    assert check_mesh(filled.mesh).watertight
    assert filled.holes == check_mesh(holed).boundaries == 7
    distances = NearestFace(whole).query(filled.mesh.vertices[len(holed.vertices) :])[0]
    assert distances.mean() < 0.002 * diagonal
    assert distances.max() < 0.01 * diagonal
    assert not count_crossings(filled.mesh, len(holed.faces))
