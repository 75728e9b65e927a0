"""Which axis is up: judged by real objects that stand, and by others that tell nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from shared_data import shared

from hpcapp.geometry import axes
from hpcapp.geometry.axes import find_up, measure_faces, turn_up
from hpcapp.geometry.axis_names import AXES
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.io import read_mesh
from hpcapp.io.meshes.mesh_stream import as_stream

STATUES = ("boot", "dancing_children", "falcon", "gargoyle", "hand", "laurana")
OTHERS = (
    "airplane", "anchor", "bumpy_cube", "daratech", "dragon_head", "gear", "lucy", "notched_ring",
    "pipes", "room", "scorpion", "screw",
)  # fmt: skip
SCENES = ("chair_in_a_corner", "cliff", "facade", "room_without_ceiling", "town_xyz_walls", "cup")


def _find(mesh: Mesh) -> str:
    stream = as_stream(mesh)
    return find_up(map(measure_faces, stream.corners()), stream.box)


@pytest.fixture(scope="module")
def known() -> list[tuple[str, Mesh]]:
    """Meshes, and the axis that is up in each."""
    known = [("y", read_mesh(shared(f"tuning/meshes/{name}.ply"))) for name in STATUES]
    known += [("y", read_mesh(shared("bunny_zipper_mesh.ply")))]
    known += [("z", read_mesh(shared(f"tuning/meshes/{name}.ply"))) for name in OTHERS]
    return known + [("z", read_mesh(shared(f"raw/truth/{name}.ply"))) for name in SCENES]


def test_objects_stand_as_they_are_known_to(known: list[tuple[str, Mesh]]) -> None:
    assert [_find(mesh) for _, mesh in known] == [up for up, _ in known]


def test_a_statue_turned_to_z_stands_there(known: list[tuple[str, Mesh]]) -> None:
    for up, mesh in known:
        turned = replace(mesh, vertices=mesh.vertices @ turn_up("y", to="z").T)
        assert up == "z" or _find(turned) == "z"


@pytest.mark.parametrize("name", ["_LEAST_BASE", "_MOST_OF_OTHERS"])
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_the_numbers_lie_between_what_they_part(
    known: list[tuple[str, Mesh]], monkeypatch: pytest.MonkeyPatch, name: str, factor: float
) -> None:
    scorpion_like = _stand(base=0.03)
    known = [*known, ("z", scorpion_like)]
    assert [_find(mesh) for _, mesh in known] == [up for up, _ in known]
    monkeypatch.setattr(axes, name, factor * getattr(axes, name))
    assert [_find(mesh) for _, mesh in known] != [up for up, _ in known]


@pytest.mark.parametrize(("hole", "up"), [(0.04, "y"), (0.1, "z")])
def test_an_open_mesh_tells_nothing(hole: float, up: str) -> None:
    """Between the bunny with its holes (.017 of its area) and a room without a ceiling (.27)."""
    assert _find(_stand(base=0.3, hole=hole)) == up


def _stand(base: float, hole: float = 0.0) -> Mesh:
    """Return a cone on its tip, cut so that it stands along y on a share of its box.

    Of its side facets so many are left out that the area vectors sum up to a share of the area.
    """
    angles = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    ring = np.stack([np.cos(angles), np.zeros(720), np.sin(angles)], axis=1)
    foot, top = ring * np.sqrt(base * 4.0 / np.pi), ring + np.array([0.0, 2.0, 0.0])
    vertices = np.vstack([foot, top, [[0.0, 0.0, 0.0], [0.0, 3.0, 0.0]]])
    one = np.arange(720)
    two = (one + 1) % 720
    side = np.vstack([np.stack([one, one + 720, two], 1), np.stack([two, one + 720, two + 720], 1)])
    bottom = np.stack([one, two, np.full(720, 1440)], axis=1)
    lid = np.stack([two + 720, one + 720, np.full(720, 1441)], axis=1)
    faces = np.vstack([bottom, side, lid])
    corners = vertices[faces]
    vectors = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(vectors, axis=1)
    if hole:
        for count in range(1, 720):
            is_left = np.ones(len(faces), np.bool_)
            is_left[720 : 720 + count] = is_left[1440 : 1440 + count] = False
            if np.linalg.norm(vectors[is_left].sum(axis=0)) > hole * areas[is_left].sum():
                return Mesh(vertices, faces[is_left])
    return Mesh(vertices, faces)


def test_turns_are_turns() -> None:
    for one in AXES:
        for other in AXES:
            turn = turn_up(one, to=other)
            assert np.linalg.det(turn) == 1.0
            np.testing.assert_array_equal(turn @ turn_up(other, to=one), np.eye(3))


def test_a_room_without_a_ceiling_stands_on_its_floor() -> None:
    """As phones scan it, with y up; with z up, as all others do, it stays."""
    room = read_mesh(shared("raw/truth/room_without_ceiling.ply"))
    assert _find(room) == "z"
    assert _find(replace(room, vertices=room.vertices @ turn_up("z", to="y").T)) == "y"


@pytest.mark.parametrize(
    ("sides", "door", "up"),
    [
        ((6.0, 2.5, 4.0), 0.0, "y"),
        ((6.0, 2.5, 4.0), 0.4, "y"),
        ((6.0, 2.5, 4.0), 0.7, "z"),  # that is half a room
        ((6.0, 4.0, 2.5), 0.0, "z"),  # higher than wide: a wall of it is missing
    ],
)
def test_its_walls_tell(sides: tuple[float, float, float], door: float, up: str) -> None:
    """A box that looks inwards, open at the upper end of y, with a gap in one wall."""
    assert _find(_open_box(np.array(sides), door)) == up


def test_part_of_a_ceiling_may_be_there() -> None:
    assert _find(_open_box(np.array([6.0, 2.5, 4.0]), ceiling=0.1)) == "y"
    assert _find(_open_box(np.array([6.0, 2.5, 4.0]), ceiling=0.4)) == "z"


def _open_box(sides: FloatArray, door: float = 0.0, ceiling: float = 0.0) -> Mesh:
    u, v = np.meshgrid(np.linspace(0.0, 1.0, 21), np.linspace(0.0, 1.0, 21), indexing="ij")
    number = np.arange(u.size).reshape(u.shape)
    a, b, c, d = (each.ravel() for each in (
        number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:],
    ))  # fmt: skip
    faces: list[NDArray[np.int64]] = []
    vertices: list[FloatArray] = []
    for axis in range(3):
        for end in (0.0, 1.0):
            place = np.insert(np.stack([u.ravel(), v.ravel()], axis=1), axis, end, axis=1)
            share = {(0, 1.0): 1.0 - door, (1, 1.0): ceiling}.get((axis, end), 1.0)
            kept = u[:-1, :-1].ravel() < share - 1e-9
            turned = (end == 1.0) != (axis == 1)
            quads = np.concatenate([np.stack([a, b, c], 1)[kept], np.stack([a, c, d], 1)[kept]])
            quads = quads[:, ::-1] if turned else quads
            faces.append(quads + u.size * len(vertices))
            vertices.append(place * sides)
    return Mesh(np.concatenate(vertices), np.concatenate(faces))
