"""Pictures: what must be covered, hidden or red."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from hpcapp.applications.surface.types.mesh import Mesh
from hpcapp.applications.surface.types.points import BoolArray, ByteArray
from hpcapp.pages.png import write_png
from hpcapp.pages.render import render_mesh

SQUARE = np.array([[0.0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])  # anticlockwise as seen from +x


def is_background(picture: ByteArray) -> BoolArray:
    values: BoolArray = (picture == 255).all(axis=2)
    return values


def test_a_square_covers_its_share_of_the_picture() -> None:
    picture = render_mesh(Mesh(SQUARE, FACES), azimuth=0, elevation=0, size=100)
    assert (~is_background(picture)).mean() == pytest.approx(0.92**2, abs=0.01)


def test_back_faces_are_red() -> None:
    behind = render_mesh(Mesh(SQUARE, FACES), azimuth=180, elevation=0, size=40)
    before = render_mesh(Mesh(SQUARE, FACES), azimuth=0, elevation=0, size=40)
    red, _, blue = behind[20, 20].astype(int)
    assert red > 2 * blue
    red, _, blue = before[20, 20].astype(int)
    assert abs(red - blue) < 30


def test_the_nearer_face_hides_the_farther_in_whichever_order() -> None:
    two = np.concatenate([SQUARE, SQUARE[::-1] - [1, 0, 0]])  # the farther one shows its back
    faces = np.concatenate([FACES, FACES + 4])
    single = render_mesh(Mesh(SQUARE, FACES), azimuth=0, elevation=0, size=40)
    for order in (faces, faces[::-1]):
        assert np.array_equal(render_mesh(Mesh(two, order), 0, 0, 40), single)


def test_an_empty_mesh_is_an_empty_picture() -> None:
    empty = Mesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))
    assert is_background(render_mesh(empty, size=16)).all()


def test_a_png_holds_the_rows_of_the_picture(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    write_png(tmp_path / "p.png", picture)
    content = (tmp_path / "p.png").read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", content[16:24]) == (7, 5)
    start = content.index(b"IDAT") + 4
    length = struct.unpack(">I", content[start - 8 : start - 4])[0]
    rows = np.frombuffer(zlib.decompress(content[start : start + length]), np.uint8).reshape(5, 22)
    assert np.array_equal(rows[:, 1:].reshape(5, 7, 3), picture)
