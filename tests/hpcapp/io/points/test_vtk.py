"""Legacy VTK: ascii and binary, with normals, colours and scalars."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hpcapp.io import read_whole
from hpcapp.io.points.vtk import open_vtk
from hpccomponent.errors import InputError

POINTS = np.arange(12.0).reshape(4, 3)
ASCII = """# vtk DataFile Version 3.0
a title
ASCII
DATASET POLYDATA
POINTS 4 float
0 1 2 3 4 5
6 7 8 9 10 11
POLYGONS 1 5
4 0 1 2 3

POINT_DATA 4
NORMALS Normals float
0 0 1 0 0 1 0 0 1 0 0 1
SCALARS height double 1
LOOKUP_TABLE default
4 3 2 1
FIELD FieldData 1
RGB 3 4 unsigned_char
255 0 0 0 255 0 0 0 255 9 9 9
"""


def binary() -> bytes:
    cells = np.array([1, 0, 1, 1, 1, 2, 1, 3], ">i4")
    return b"".join(
        [
            b"# vtk DataFile Version 4.2\ntitle\nBINARY\nDATASET UNSTRUCTURED_GRID\n",
            b"POINTS 4 double\n", POINTS.astype(">f8").tobytes(), b"\n",
            b"CELLS 4 8\n", cells.tobytes(), b"\n",
            b"CELL_TYPES 4\n", np.ones(4, ">i4").tobytes(), b"\n",
            b"POINT_DATA 4\nSCALARS intensity short\nLOOKUP_TABLE default\n",
            np.array([1, -2, 3, 4], ">i2").tobytes(), b"\n",
        ]
    )  # fmt: skip


def test_an_ascii_file_gives_points_normals_colours_and_scalars(tmp_path: Path) -> None:
    (tmp_path / "a.vtk").write_text(ASCII)
    cloud = read_whole(open_vtk(tmp_path / "a.vtk"))
    np.testing.assert_array_equal(cloud.positions, POINTS)
    np.testing.assert_array_equal(cloud.normals, [[0, 0, 1]] * 4)
    np.testing.assert_array_equal(cloud.colours, [[255, 0, 0], [0, 255, 0], [0, 0, 255], [9] * 3])
    np.testing.assert_array_equal(cloud.attributes["height"], [4, 3, 2, 1])


def test_a_binary_file_is_big_endian(tmp_path: Path) -> None:
    (tmp_path / "a.vtk").write_bytes(binary())
    cloud = read_whole(open_vtk(tmp_path / "a.vtk"))
    np.testing.assert_array_equal(cloud.positions, POINTS)
    assert cloud.attributes["intensity"].tolist() == [1, -2, 3, 4]


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("# vtk", "# tvk", "not a legacy VTK file"),
        ("POLYDATA", "STRUCTURED_POINTS", "no data set with points"),
        ("POINTS 4 float\n0 1", "POINTS 4 float\n0 x", "not numbers"),
        ("POINTS 4 float", "POINTS 9999 float", "truncated"),
        ("POINTS 4 float", "POINTS 999999999999 float", "truncated"),
        ("POINTS 4 float", "POINTS four float", "not a count"),
        ("ASCII", "EBCDIC", "neither ASCII nor BINARY"),
    ],
)
def test_a_bad_file_is_refused(tmp_path: Path, old: str, new: str, problem: str) -> None:
    (tmp_path / "a.vtk").write_text(ASCII.replace(old, new))
    with pytest.raises(InputError, match=rf"a\.vtk: {problem}"):
        open_vtk(tmp_path / "a.vtk")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(data=st.data(), is_binary=st.booleans())
def test_damage_gives_points_or_one_line(
    tmp_path: Path, data: st.DataObject, is_binary: bool
) -> None:
    content = bytearray(binary() if is_binary else ASCII.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    (tmp_path / "a.vtk").write_bytes(content[: data.draw(st.integers(0, len(content)))])
    with suppress(InputError):
        assert read_whole(open_vtk(tmp_path / "a.vtk")).positions.shape[1] == 3
