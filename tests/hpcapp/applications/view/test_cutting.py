"""What the page of a file knows of cutting it."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpcapp.applications.view.cutting import mark_pieces, plan_cutting, take_pieces
from hpcapp.applications.view.page import make_page, read_shown
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.pieces import PieceChoice
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_mesh, write_points
from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.mending.mend import Mending, mend_mesh
from hpcapp.pages.cutting import MOST_PIECES
from hpcapp.pages.scene import MOST_POINTS
from hpcapp.pages.thin import thin_mesh
from hpcapp.parts.crop import EVERYTHING, Crop

TRIANGLE = np.array([[0.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0]])
MESH = Mesh(TRIANGLE, np.array([[0, 1, 2]]))
CLOUD = PointCloud(TRIANGLE)


def make_triangles(sides: list[float]) -> Mesh:
    """Return triangles beside each other."""
    aside = 2.0 * np.arange(len(sides))[:, None, None] * np.array([1.0, 0, 0])
    vertices = np.array(sides)[:, None, None] * TRIANGLE + aside
    return Mesh(vertices.reshape(-1, 3), np.arange(3 * len(sides)).reshape(-1, 3))


def read_scene(path: Path, crop: Crop = EVERYTHING) -> dict[str, Any]:
    page = make_page(path, read_shown(path, crop), crop=crop)
    scene: dict[str, Any] = json.loads(page.split('id="scene">')[1].split("</script>")[0])
    return scene


@pytest.mark.parametrize(
    ("name", "shown", "made"),
    [
        ("a b.obj", MESH, {"mesh": ["mend", "a b.obj", "-o", "a b-cut.obj"]}),
        ("s/m.stl", MESH, {"mesh": ["mend", "s/m.stl", "-o", "s/m-cut.stl"]}),
        (
            "p.ptx",  # which is read only
            CLOUD,
            {
                "points": ["convert", "p.ptx", "-o", "p-cut.ply"],
                "mesh": ["reconstruct", "p.ptx", "-o", "p-cut.ply"],
            },
        ),
    ],
)
def test_commands_write_what_can_be_written(
    name: str, shown: Mesh | PointCloud, made: dict[str, list[str]]
) -> None:
    commands = plan_cutting(Path(name), shown, UNKNOWN).commands
    assert {label: shlex.split(text)[1:] for label, text in commands.items()} == made


@pytest.mark.parametrize("name", ["-a b'c;$(d).ply", "ä.ply", "..ply"])
def test_the_polygon_has_a_name_that_no_shell_takes_apart(name: str) -> None:
    polygon = plan_cutting(Path(name), MESH, Crs("EPSG:25832", "m")).polygon
    assert shlex.quote(polygon) == polygon
    assert not polygon.startswith("-")


def test_a_box_begins_around_points_that_the_page_leaves_out(tmp_path: Path) -> None:
    places = np.random.default_rng(0).random((MOST_POINTS + 2, 3))
    places[[1, 3]] = [[7.0, -8.0, 9.0], [np.nan, 0.0, 0.0]]  # of each two the first is shown
    write_points(tmp_path / "c.npz", PointCloud(places))
    scene = read_scene(tmp_path / "c.npz")
    assert scene["points"]["shown"] == MOST_POINTS // 2 + 1
    corners = np.array([scene["cutting"][name] for name in ("low", "high")]) + scene["origin"]
    finite = np.delete(places, 3, axis=0)
    np.testing.assert_array_equal(corners, [finite.min(axis=0), finite.max(axis=0)])


def test_pieces_are_sorted_as_they_are_kept() -> None:
    mesh = make_triangles([1.0, 0.5, 1.0, 0.01, 1.5])
    thin, pieces = take_pieces(*mark_pieces(mesh))
    assert pieces is not None
    assert pieces.ranks.reshape(-1, 3)[:, 0].tolist() == [1, 3, 2, 4, 0]
    assert pieces.suggested == 4
    assert thin.attributes == {}
    for most in (1, 2, 4):
        kept = mend_mesh(mesh, Mending(choice=PieceChoice(most)))
        np.testing.assert_array_equal(kept.vertices, mesh.vertices[pieces.ranks < most])


def test_pieces_of_a_copy_are_those_of_the_whole_mesh() -> None:
    """Two squares, so near that the copy cannot tell them apart: still there are two pieces."""
    steps = np.linspace(0.0, 1.0, 60)
    sheet = np.stack(np.meshgrid(steps, steps, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    corner = np.arange(3600).reshape(60, 60)[:-1, :-1].ravel()
    faces = np.concatenate([corner[:, None] + [0, 60, 61], corner[:, None] + [0, 61, 1]])
    near = np.concatenate([sheet, 0.5 * sheet + [1.001, 0, 0]])
    marked, areas = mark_pieces(Mesh(near, np.concatenate([faces, faces + 3600])))
    thin, pieces = take_pieces(thin_mesh(marked, 500), areas)
    assert pieces is not None
    assert len(pieces.ranks) == len(thin.vertices) < 500
    np.testing.assert_allclose(pieces.areas, [1.0, 0.25], rtol=1e-6)
    is_clear = np.abs(thin.vertices[:, 0] - 1.0) > 0.1  # a cell of the copy
    np.testing.assert_array_equal(pieces.ranks[is_clear], thin.vertices[is_clear, 0] > 1.0)


def test_one_piece_and_places_that_are_none_have_no_pieces() -> None:
    assert take_pieces(*mark_pieces(MESH))[1] is None
    broken = make_triangles([1.0, 1.0])
    broken.vertices[0] = np.nan
    assert take_pieces(*mark_pieces(broken))[1] is None


def test_a_page_of_many_pieces_names_the_largest(tmp_path: Path) -> None:
    write_mesh(tmp_path / "m.ply", make_triangles([1.0] * (MOST_PIECES + 5)))
    pieces = read_scene(tmp_path / "m.ply")["cutting"]["pieces"]
    assert pieces["count"] == MOST_PIECES + 5
    assert len(pieces["shares"]) == pieces["suggested"] == MOST_PIECES
    assert pieces["shares"][-1] == pytest.approx(MOST_PIECES / (MOST_PIECES + 5), abs=1e-6)


def test_a_part_is_not_cut_again(tmp_path: Path) -> None:
    write_points(tmp_path / "c.ply", CLOUD)
    assert read_scene(tmp_path / "c.ply")["cutting"] is not None
    assert read_scene(tmp_path / "c.ply", Crop(box=(0, 0, -1, 1, 1, 1)))["cutting"] is None
