import struct
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io.formats import read_points
from hpcapp.io.ply.format import read_ply_mesh, shared_ply, write_ply_mesh, write_ply_points
from hpcapp.io.ply.points import open_ply
from hpcapp.io.points.point_source import read_whole
from hpccomponent.errors import InputError, OutputError

Make = Callable[..., Path]
XYZ = "property float x\nproperty float y\nproperty float z\n"
COORDINATES = st.floats(-1e300, 1e300) | st.sampled_from([np.nan, np.inf, -np.inf])
SQUARE = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"


def test_everything_of_a_cloud_comes_back(tmp_path: Path, cloud: PointCloud) -> None:
    write_ply_points(tmp_path / "cloud.ply", cloud)
    again = read_points(tmp_path / "cloud.ply")
    assert (again.positions == cloud.positions).all()
    np.testing.assert_array_equal(again.normals, cloud.normals)
    np.testing.assert_array_equal(again.colours, cloud.colours)
    assert again.colours is not None
    assert again.colours.dtype == np.uint8


@pytest.mark.parametrize(
    ("dtype", "read"),
    [
        ("u1", "u1"), ("i2", "i2"), ("u4", "u4"), ("i8", "f8"), (">i2", "i2"), ("?", "u1"),
        ("f2", "f4"), ("f4", "f4"), (">f8", "f8"),
    ],
)  # fmt: skip
def test_attributes_come_back_under_their_names(tmp_path: Path, dtype: str, read: str) -> None:
    values = np.array([0, 1, 1]).astype(dtype)
    cloud = PointCloud(np.eye(3), attributes={"time of day": values, "intensity": values})
    write_ply_points(tmp_path / "cloud.ply", cloud)
    again = read_points(tmp_path / "cloud.ply").attributes
    assert list(again) == ["time_of_day", "intensity"]
    for column in again.values():
        assert column.tolist() == [0, 1, 1]
        assert column.dtype == np.dtype(read)


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None
)
@given(
    hnp.arrays(np.float64, st.tuples(st.integers(0, 30), st.just(3)), elements=COORDINATES),
    st.sampled_from([0.0, 1e3, 5.4e6]),
)
def test_any_positions_come_back(tmp_path: Path, positions: np.ndarray, shift: float) -> None:
    path = tmp_path / "cloud.ply"
    cloud = PointCloud(positions, origin=np.full(3, shift))
    write_ply_points(path, cloud)
    again = read_whole(open_ply(path))
    with np.errstate(all="ignore"):
        written, read = positions + shift, again.positions + again.origin
        usable = np.isfinite(written).all(axis=1)
        finite = written[usable]
        extent = np.ptp(finite, axis=0).max() if len(finite) else 0.0
        tolerance = 1e-6 * extent + np.spacing(np.abs(finite).max(initial=0.0))
    assert (np.isfinite(read).all(axis=1) == usable).all()
    np.testing.assert_allclose(read[usable], finite, rtol=0, atol=tolerance)


def test_georeferenced_millimetres_survive(tmp_path: Path) -> None:
    detail = np.random.default_rng(2).uniform(0, 100, (1000, 3)).round(3)
    utm = detail + np.array([450_000.0, 5_400_000.0, 300.0])
    write_ply_points(tmp_path / "a.ply", PointCloud(utm))
    cloud = read_points(tmp_path / "a.ply")
    assert cloud.origin[1] > 5_399_999
    assert np.abs(cloud.positions).max() < 100
    write_ply_mesh(tmp_path / "b.ply", Mesh(cloud.positions, np.array([[0, 1, 2]]), cloud.origin))
    mesh = read_ply_mesh(tmp_path / "b.ply")
    assert np.abs(mesh.vertices + mesh.origin - utm).max() < 1e-6


def test_coordinates_are_float_near_zero_and_double_elsewhere(
    tmp_path: Path, tetrahedron: Mesh
) -> None:
    path = tmp_path / "mesh.ply"
    write_ply_mesh(path, tetrahedron)
    assert b"property float x\n" in path.read_bytes()
    write_ply_mesh(path, Mesh(tetrahedron.vertices, tetrahedron.faces, np.array([7.0, 0, 0])))
    assert b"property double x\n" in path.read_bytes()


def test_a_mesh_comes_back_and_serves_as_a_cloud(tmp_path: Path, tetrahedron: Mesh) -> None:
    write_ply_mesh(tmp_path / "mesh.ply", tetrahedron)
    again = read_ply_mesh(tmp_path / "mesh.ply")
    assert (again.vertices == tetrahedron.vertices).all()
    assert (again.faces == tetrahedron.faces).all()
    assert (read_points(tmp_path / "mesh.ply").positions == tetrahedron.vertices).all()


def test_the_same_mesh_gives_the_same_bytes(tmp_path: Path, tetrahedron: Mesh) -> None:
    for name in ("a.ply", "b.ply"):
        write_ply_mesh(tmp_path / name, tetrahedron)
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


@pytest.mark.parametrize("spelling", ["vertex_indices", "vertex_index"])
@pytest.mark.parametrize("before", ["", "7 "])
def test_polygons_become_fans(make_ply: Make, spelling: str, before: str) -> None:
    extra = "property float quality\n" if before else ""
    elements = (
        f"element vertex 4\n{XYZ}element face 2\n{extra}property list uchar uint {spelling}\n"
    )
    body = f"{SQUARE}{before}4 0 1 2 3\n{before}3 0 2 1\n"
    mesh = read_ply_mesh(make_ply("ascii", elements, body))
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 2, 1]]


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("second", [(0, 2, 1), (0, 1, 2, 3, 0)])
def test_binary_polygons_become_fans(make_ply: Make, order: str, second: tuple[int, ...]) -> None:
    sign = {"little": "<", "big": ">"}[order]
    body = np.array(SQUARE.split(), sign + "f4").tobytes()
    for face in [(0, 1, 2), second]:
        body += struct.pack(f"{sign}B{len(face)}H", len(face), *face)
    lists = "element face 2\nproperty list uchar ushort vertex_indices\n"
    path = make_ply(f"binary_{order}_endian", f"element vertex 4\n{XYZ}{lists}", body)
    fan = [[second[0], a, b] for a, b in pairwise(second[1:])]
    assert read_ply_mesh(path).faces.tolist() == [[0, 1, 2], *fan]


@pytest.mark.parametrize(
    ("elements", "body", "said"),
    [
        ("element point 1\n" + XYZ, "1 2 3\n", "no element 'vertex'"),
        ("element vertex 1\nproperty float x\nproperty int y\n", "1 2\n", "has no z"),
        (f"element vertex 1\n{XYZ}property float nx\n", "1 2 3 0\n", "has nx but not all of"),
    ],
)
def test_a_cloud_needs_whole_vertices(make_ply: Make, elements: str, body: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_points(make_ply("ascii", elements, body))


@pytest.mark.parametrize(
    ("faces", "body", "said"),
    [
        ("", "", "not a mesh"),
        ("element face 1\nproperty list uchar float vertex_indices\n", "3 0 1 2\n", "not a mesh"),
        ("element face 1\nproperty list uchar int corners\n", "3 0 1 2\n", "not a mesh"),
        ("element face 1\nproperty list uchar int vertex_index\n", "3 0 1 4\n", "names vertex 4"),
        ("element face 1\nproperty list uchar int vertex_index\n", "3 0 -1 2\n", "names vertex -1"),
        ("element face 1\nproperty list uchar int vertex_index\n", "2 0 1\n", "face 0 has 2 corn"),
    ],
)
def test_a_mesh_needs_faces_of_its_vertices(
    make_ply: Make, faces: str, body: str, said: str
) -> None:
    path = make_ply("ascii", f"element vertex 4\n{XYZ}{faces}", SQUARE + body)
    with pytest.raises(InputError, match=said):
        read_ply_mesh(path)


def test_more_vertices_than_a_face_can_name_are_refused(tmp_path: Path) -> None:
    with (
        pytest.raises(OutputError, match=r"\.tiles"),
        shared_ply(tmp_path / "mesh.ply", (2**31, 1), np.zeros(3), np.zeros((2, 3))),
    ):
        pass
    assert not list(tmp_path.iterdir())
