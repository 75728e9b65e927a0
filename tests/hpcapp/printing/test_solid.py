"""Solids against shapes whose volume is known: sheets that are backed or walled, bases, walls."""

from __future__ import annotations

import numpy as np
import pytest
from crossings import count_crossings
from cut_mesh import ball, extract_shape
from sheets import grid_faces, sweep

from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray

pytest.importorskip("manifold3d")
from hpcapp.printing.solid import Body, back_relief, stand, thicken

CUBE = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
SIDES = np.array(
    [[0, 2, 3], [0, 3, 1], [0, 1, 5], [0, 5, 4], [1, 3, 7], [1, 7, 5],
     [3, 2, 6], [3, 6, 7], [2, 0, 4], [2, 4, 6], [4, 5, 7], [4, 7, 6]]
)  # fmt: skip


def make_hills(count: int = 21) -> tuple[FloatArray, IntArray]:
    """A sheet of 100 x 100 that faces up, with heights that differ by 18."""
    x, y = np.meshgrid(np.linspace(0, 100, count), np.linspace(0, 100, count))
    heights = 9 * np.sin(x / 20) * np.cos(y / 15)
    return np.stack([x, y, heights], axis=-1).reshape(-1, 3), grid_faces(count, count)


def check_flat(body: Body) -> None:
    """It is closed, and rests on a plane whose area is that of its base."""
    topology = check_mesh(Mesh(body.vertices, body.faces))
    assert topology.watertight
    assert topology.outward
    low = body.vertices[:, 2].min()
    corners = body.vertices[body.faces]
    flat = corners[(np.abs(corners[:, :, 2] - low) < 1e-9).all(axis=1)]
    area = 0.5 * np.abs(cross_edges(flat)[:, 2]).sum()
    assert area == pytest.approx(body.base, rel=1e-6)
    assert area > 0.0


def test_a_relief_is_the_prism_below_it() -> None:
    vertices, faces = make_hills()
    low = vertices[:, 2].min()
    body = stand(*back_relief(vertices, faces, 2.0), 1, 0.4, (low - 2.0, low - 2.0))
    check_flat(body)
    corners = vertices[faces]
    areas = 0.5 * cross_edges(corners)[:, 2]
    expected = (areas * (corners[:, :, 2].mean(axis=1) - low + 2.0)).sum()
    assert body.volume == pytest.approx(expected, rel=1e-9)
    assert body.base == pytest.approx(1e4)
    assert body.thin == 0.0
    assert body.stands


def test_a_wall_is_as_thick_as_it_says_also_in_corners() -> None:
    room = SIDES[:-2, ::-1]  # seen from inside, without a ceiling
    body = stand(*thicken(CUBE * [50, 40, 30], room, 2.0), 1, 0.4, (-2.0, -1.0))
    check_flat(body)
    assert body.volume == pytest.approx(54 * 44 * 32 - 50 * 40 * 30, rel=1e-6)
    assert np.ptp(body.vertices, axis=0).tolist() == pytest.approx([54, 44, 32])


def make_ridge(bend: float) -> Mesh:
    """Two slopes of 10 x 10 that meet at a ridge, its vertices 1 and 4, and turn by degrees."""
    slope = 10.0 * np.array([np.cos(np.radians(bend / 2)), -np.sin(np.radians(bend / 2))])
    return sweep(np.stack([slope * [-1, 1], 0 * slope, slope]), 10.0, 2)


@pytest.mark.parametrize(("angle", "length"), [(72.0, 1.701), (45.0, 2.0)])
def test_a_wall_is_no_longer_than_twice_its_thickness(angle: float, length: float) -> None:
    """Behind a ridge of so many degrees it would be 1.70 and 2.61."""
    mesh = make_ridge(180.0 - angle)
    behind = thicken(mesh.vertices, mesh.faces, 1.0)[0][6:]
    steps = np.linalg.norm(mesh.vertices - behind, axis=1)
    assert steps[[1, 4]].tolist() == pytest.approx([length] * 2, abs=0.25)


@pytest.mark.parametrize(("bend", "is_one_plane"), [(14.0, True), (19.0, False)])
def test_faces_that_bend_little_are_one_plane_to_a_wall(bend: float, is_one_plane: bool) -> None:
    """The smaller of their eigenvalues is .015 and .028 of the larger one."""
    mesh = make_ridge(bend)
    behind = thicken(mesh.vertices, mesh.faces, 1.0)[0][6:]
    assert (abs(behind[1, 0]) > 0.01) == is_one_plane  # aside, by the face more on one slope
    assert mesh.vertices[1, 2] - behind[1, 2] == pytest.approx(1.0, abs=0.02)


def test_behind_a_rough_sheet_nothing_folds() -> None:
    """Its edges are a sixth of the wall."""
    sheet = sweep(np.stack([np.linspace(0, 5, 16), np.zeros(16)], axis=1), 5.0, 16)
    rough = sheet.vertices.copy()
    rough[:, 2] = np.random.default_rng(0).normal(0.0, 0.07, len(rough))
    assert not count_crossings(Mesh(*thicken(rough, sheet.faces, 2.0)), 0)


def test_a_ball_stands_on_a_cap_that_is_cut_off() -> None:
    mesh, *_ = extract_shape(lambda points: ball(points, (0, 0, 0), 0.8))
    body = stand(100 * mesh.vertices, mesh.faces, 1, 0.4)
    check_flat(body)
    assert 6.0 < body.lost < 10.0  # of 160: half of the lowest tenth
    whole, cap = 4 / 3 * np.pi * 80**3, np.pi * body.lost**2 * (80 - body.lost / 3)
    assert body.volume == pytest.approx(whole - cap, rel=0.01)
    assert body.base == pytest.approx(np.pi * body.lost * (160 - body.lost), rel=0.02)


def test_an_uneven_bottom_is_cut_where_it_is_whole() -> None:
    """A plinth whose bottom is uneven by 1.5 of its 100 loses little more."""
    random = np.random.default_rng(0)
    top, faces = make_hills()
    upper = np.concatenate([top[:, :2], np.full((len(top), 1), 100.0)], axis=1)
    lower = np.concatenate([top[:, :2], random.uniform(0, 1.5, (len(top), 1))], axis=1)
    rows = np.arange(len(top)).reshape(21, 21)
    rim = np.concatenate([rows[0, :-1], rows[:-1, -1], rows[-1, :0:-1], rows[:0:-1, 0]])
    after, down = np.roll(rim, -1), len(top)
    walls = [np.stack([rim + down, after + down, after], 1), np.stack([rim + down, after, rim], 1)]
    every = np.concatenate([faces, faces[:, ::-1] + down, *walls])
    body = stand(np.concatenate([upper, lower]), every, 1, 0.4)
    check_flat(body)
    assert 1.2 < body.lost < 1.8
    assert body.base > 9800.0


@pytest.mark.parametrize(("height", "thin"), [(0.3, 0.99), (0.5, 0.0)])
def test_what_is_thinner_than_a_nozzle_is_measured(height: float, thin: float) -> None:
    body = stand(CUBE * [80, 80, height], SIDES, 1, 0.4)
    assert body.thin == pytest.approx(thin, abs=0.02)


def test_what_leans_too_far_is_told() -> None:
    assert stand(CUBE * 20, SIDES, 1, 0.4).stands
    leaning = CUBE * 20 + np.where(CUBE[:, 2:] > 0, [[30.0, 0.0, 0.0]], 0.0)
    assert not stand(leaning, SIDES, 1, 0.4).stands


def test_of_what_the_cut_leaves_the_largest_stays() -> None:
    far = CUBE * [10, 10, 2] + [60, 0, 0]
    both = np.concatenate([CUBE * 20, far]), np.concatenate([SIDES, SIDES + 8])
    body = stand(*both, 1, 0.4)
    assert body.pieces == 2
    assert body.volume == pytest.approx(8000, rel=1e-3)
    assert stand(*both, 2, 0.4).volume == pytest.approx(8200, rel=1e-3)
