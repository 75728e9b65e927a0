"""Vertices of PLY files in their dialects: what they become, and what is said of it."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from read_parts import read_parts

from hpcapp.applications.surface.reading.tasks import FileRange
from hpcapp.io.ply.points import open_ply
from hpccomponent.errors import InputError
from hpccomponent.protocol.codec import decode_values, encode_values

Make = Callable[..., Path]
XYZ = "property float x\nproperty float y\nproperty float z\n"
FACES = "property list uchar int vertex_indices\n"
POINTS = np.array([[1.5, 2.5, -3.5], [4.0, 5.0, 6.0], [-7.0, 8.0, 9.25]])


def columns(names: str, kind: str = "float") -> str:
    return "".join(f"property {kind} {name}\n" for name in names.split())


BINARY = {"binary_little_endian": "<", "binary_big_endian": ">"}
ENCODINGS = ["ascii", *BINARY]


def body_of(encoding: str, fields: list[tuple[str, NDArray[np.generic]]]) -> bytes:
    """Rows of some columns, each of a numpy type without byte order."""
    if encoding == "ascii":
        rows = zip(*(values.astype(kind).tolist() for kind, values in fields), strict=True)
        return "".join(" ".join(map(repr, row)) + "\n" for row in rows).encode()
    order = BINARY[encoding]
    table = np.empty(len(fields[0][1]), [(f"c{i}", order + k) for i, (k, _) in enumerate(fields)])
    for i, (_, values) in enumerate(fields):
        table[f"c{i}"] = values
    return table.tobytes()


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("with_list", [False, True])
def test_other_columns_are_attributes_however_they_are_stored(
    make_ply: Make, encoding: str, with_list: bool
) -> None:
    elements = "element vertex 3\n" + columns("x y z Quality")
    elements += columns("ring", "ushort") + columns("scalar_Intensity time", "double")
    elements += "property list uchar uchar seen\n" if with_list else ""
    values = np.array([3, 1, 2])
    fields = [("f4", column) for column in POINTS.T]
    fields += [("f4", values / 2), ("u2", values), ("f8", values / 3), ("f8", values * 1e9)]
    body = body_of(encoding, fields)
    if with_list and encoding == "ascii":
        body = b"".join(
            row + b" %d" % i + b" 7" * i + b"\n" for i, row in enumerate(body.splitlines())
        )
    elif with_list:
        width = len(body) // 3
        rows = [body[i * width : (i + 1) * width] for i in range(3)]
        body = b"".join(row + bytes([i, *range(i)]) for i, row in enumerate(rows))
    source = open_ply(make_ply(encoding, elements, body))
    cloud = read_parts(source, 2)
    assert (cloud.positions == POINTS).all()
    assert {name: column.tolist() for name, column in cloud.attributes.items()} == {
        "Quality": (values / 2).tolist(),
        "ring": values.tolist(),
        "intensity": (values / 3).tolist(),
        "time": (values * 1e9).tolist(),
    }
    assert cloud.attributes["ring"].dtype == np.uint16
    assert (source.records is None) == (encoding == "ascii" or with_list)
    if source.records is not None:
        (records,) = decode_values(*encode_values((source.records,)))
        assert records.attributes == source.records.attributes
        assert list(records.read(1, 2, ("time", "normals")).attributes) == ["time"]
        assert records.read(1, 2, ()).attributes == {}
        (piece,) = FileRange(records, 0, 3).pieces()  # tasks do without attributes
        assert (piece.positions == POINTS).all()
        assert not piece.attributes
        assert records.read(1, 2).attributes["time"].tolist() == [1e9]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(
    "names", ["red green blue", "r g b", "diffuse_red diffuse_green Diffuse_Blue"]
)
@pytest.mark.parametrize(
    ("kind", "numpy_kind", "read"),
    [("uchar", "u1", "u1"), ("ushort", "u2", "u2"), ("float", "f4", "f4"), ("int", "i4", "f4")],
)
def test_colours_are_read_as_they_are(
    make_ply: Make, encoding: str, names: str, kind: str, numpy_kind: str, read: str
) -> None:
    colours = np.array([[200, 1, 0], [3, 4, 5], [255, 0, 9]])
    elements = f"element vertex 3\n{XYZ}" + columns(names, kind) + columns("alpha", "uchar")
    fields = [("f4", column) for column in POINTS.T]
    fields += [(numpy_kind, column) for column in colours.T] + [("u1", np.full(3, 255))]
    cloud = read_parts(open_ply(make_ply(encoding, elements, body_of(encoding, fields))), 2)
    assert cloud.colours is not None
    assert cloud.colours.dtype == np.dtype(read)
    assert cloud.colours.tolist() == colours.tolist()
    assert cloud.attributes["alpha"].tolist() == [255] * 3


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_signed_byte_in_a_colour_is_an_unsigned_one(make_ply: Make, encoding: str) -> None:
    elements = f"element vertex 3\n{XYZ}" + columns("red green", "uchar") + columns("blue", "char")
    fields = [("f4", column) for column in POINTS.T] + [("u1", np.array([1, 128, 255]))] * 3
    cloud = read_parts(open_ply(make_ply(encoding, elements, body_of(encoding, fields))), 2)
    assert cloud.colours is not None
    assert cloud.colours.tolist() == [[1] * 3, [128] * 3, [255] * 3]


@pytest.mark.parametrize("names", ["normal_x normal_y normal_z", "normalx normaly normalz"])
def test_normals_have_many_names(make_ply: Make, names: str) -> None:
    path = make_ply("ascii", f"element vertex 1\n{XYZ}{columns(names)}", "1 2 3 0 0 2\n")
    source = open_ply(path)
    assert source.has_normals
    assert source.oriented
    cloud = read_parts(source, 2)
    assert cloud.normals is not None
    assert cloud.normals.tolist() == [[0, 0, 2]]


def test_short_coordinates_and_a_name_that_could_be_z(make_ply: Make) -> None:
    elements = "element vertex 1\n" + columns("height") + columns("x y z", "short")
    source = open_ply(make_ply("ascii", elements, "7 -1 2 3\n"))
    assert read_parts(source, 2).positions.tolist() == [[-1, 2, 3]]
    assert read_parts(source, 2).attributes["height"].tolist() == [7]
    assert source.columns == ("height", "x", "y", "z")
    assert source.format == "PLY, ascii"


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_list_that_no_row_holds_is_passed_over(make_ply: Make, encoding: str) -> None:
    elements = f"element vertex 3\n{XYZ}{FACES}"
    body = body_of(encoding, [("f4", column) for column in POINTS.T])
    source = open_ply(make_ply(encoding, elements, body))
    assert (read_parts(source, 2).positions == POINTS).all()
    (warning,) = source.findings.warnings
    assert "line 7 of the header declares the list 'vertex_indices'" in warning


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("before", [False, True])
def test_a_mesh_without_normals_takes_them_from_its_faces(
    make_ply: Make, encoding: str, before: bool
) -> None:
    """A square of two by two, a triangle at a right angle to it, and a vertex of no face."""
    vertices = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [9, 9, 9], [0, 0, 2]])
    faces = [(0, 1, 2, 3), (0, 3, 5)]
    vertex_body = body_of(encoding, [("f4", c) for c in vertices.T] + [("u1", np.arange(6))])
    if encoding == "ascii":
        face_body = "".join(f"{len(f)} {' '.join(map(str, f))}\n" for f in faces).encode()
    else:
        face_body = b"".join(struct.pack(f"<B{len(f)}i", len(f), *f) for f in faces)
    vertex, face = f"element vertex 6\n{XYZ}property uchar id\n", f"element face 2\n{FACES}"
    path = make_ply(
        encoding,
        face + vertex if before else vertex + face,
        face_body + vertex_body if before else vertex_body + face_body,
    )
    source = open_ply(path)
    assert source.has_normals
    for _ in range(2):  # it is counted once however often it is read
        cloud = read_parts(source, 2)
        assert cloud.attributes["id"].tolist() == [0, 1, 2, 3, 5]
        assert cloud.normals is not None
        assert cloud.normals.tolist() == [[2, 0, 4], [0, 0, 4], [0, 0, 4], [2, 0, 4], [2, 0, 0]]
        assert source.findings.dropped == {"vertices without a face": 1}


def test_faces_are_not_asked_where_there_are_normals_or_no_corners(make_ply: Make) -> None:
    for names, row in (("nx ny nz", "1 2 3 0 0 1"), ("", "1 2 3")):
        elements = f"element vertex 1\n{XYZ}{columns(names)}element face 1\n"
        elements += FACES if names else "property list uchar float vertex_indices\n"
        source = open_ply(make_ply("ascii", elements, f"{row}\n3 7 8 9\n"))
        assert len(read_parts(source, 2)) == 1
        assert source.has_normals == bool(names)


@pytest.mark.parametrize("corner", [-1, 3])
def test_a_face_of_other_vertices_is_refused(make_ply: Make, corner: int) -> None:
    elements = f"element vertex 3\n{XYZ}element face 1\n{FACES}"
    path = make_ply("ascii", elements, f"0 0 0\n1 0 0\n0 1 0\n3 0 1 {corner}\n")
    with pytest.raises(InputError, match=f"a face names vertex {corner}, but the file has 3"):
        read_parts(open_ply(path), 2)


@pytest.mark.parametrize("scales", [3, 2])
def test_splats_point_along_their_shortest_axis(make_ply: Make, scales: int) -> None:
    """Three splats, turned about z by none, a quarter and half a turn; the quaternions' lengths
    are none of 1. Flat ones have two scales, and lie in their plane of x and y."""
    names = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 f_rest_0 opacity "
    names += " ".join(f"scale_{i}" for i in range(scales)) + " rot_0 rot_1 rot_2 rot_3"
    rows = [
        [1, 2, 3, 0, 0, 0, 0, 1, 9, 5, 0.5, *[-9, 1, 1][:scales], 2, 0, 0, 0],
        [4, 5, 6, 0, 0, 0, 0, 1, -9, 5, 0.25, *[-9, 1, 1][:scales], 3, 0, 0, 3],
        [7, 8, 9, 0, 0, 0, 0, 1, 9, 5, 0.125, *[1, -9, 1][:scales], 0, 0, 0, 0.5],
    ]
    body = np.array(rows, "<f4").tobytes()
    path = make_ply("binary_little_endian", f"element vertex 3\n{columns(names)}", body)
    source = open_ply(path)
    cloud = read_parts(source, 2)
    assert source.has_normals
    assert not source.oriented
    assert source.records is None
    assert "splats" in source.findings.warnings[0]
    expected = [[1, 0, 0], [0, 1, 0], [0, -1, 0]] if scales == 3 else [[0, 0, 1]] * 3
    np.testing.assert_allclose(cloud.normals, expected, atol=1e-12)  # type: ignore[arg-type]
    assert cloud.colours is not None
    np.testing.assert_allclose(
        cloud.colours, [[0.5, 0.782095, 1], [0.5, 0.782095, 0], [0.5, 0.782095, 1]], atol=1e-6
    )
    assert {name: v.tolist() for name, v in cloud.attributes.items()} == {
        "opacity": [0.5, 0.25, 0.125]
    }


def test_floaters_among_splats_are_left_out_and_counted(make_ply: Make) -> None:
    """Training leaves fog of about 0.04; a surface has about 0.94."""
    opacities = np.array([0.94, 0.004, 0.4, 0.04, 0.2, 0.99, 0.5])
    names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
    rows = np.tile([0.0, 0, 0, 0, 0, 0, 0, -3, -3, -6, 1, 0, 0, 0], (len(opacities), 1))
    rows[:, 0], rows[:, 6] = np.arange(len(opacities)), np.log(opacities / (1.0 - opacities))
    body = rows.astype("<f4").tobytes()
    path = make_ply("binary_little_endian", f"element vertex 7\n{columns(names)}", body)
    source = open_ply(path)
    for _ in range(2):  # a file may be read more than once
        parts = list(source.chunks(2))
        assert [part.positions[:, 0].tolist() for part in parts] == [[0, 2], [5, 6]]
        assert source.findings.dropped == {"splats that are hardly opaque": 3}


def test_splats_without_an_opacity_stay(make_ply: Make) -> None:
    names = "x y z f_dc_0 f_dc_1 f_dc_2 scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
    body = np.ones((3, 13), "<f4").tobytes()
    path = make_ply("binary_little_endian", f"element vertex 3\n{columns(names)}", body)
    assert len(read_parts(open_ply(path), 2)) == 3


def test_the_camera_is_the_scanner_unless_it_is_at_the_origin(make_ply: Make) -> None:
    for view in ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0]):
        elements = f"element vertex 1\n{XYZ}element camera 1\n" + columns(
            "view_px view_py view_pz focal"
        )
        row = " ".join(map(str, [*view, 50]))
        (scan,) = open_ply(make_ply("ascii", elements, f"5 6 7\n{row}\n")).scans
        assert (None if scan.scanner is None else scan.scanner.tolist()) == (
            view if any(view) else None
        )


@pytest.mark.parametrize("encoding", ["ascii", "binary_big_endian"])
@pytest.mark.parametrize("columns_said", [3, 4])
def test_a_range_scan_has_a_grid(make_ply: Make, encoding: str, columns_said: int) -> None:
    """Three vertices, two of them in a grid of three by two."""
    cells: list[list[int]] = [[], [1], [], [0], [], []]
    elements = (
        f"obj_info num_cols {columns_said}\nobj_info num_rows 2\nobj_info echo data 1\n"
        f"element vertex 3\n{XYZ}element range_grid 6\n{FACES}"
    )
    body = body_of(encoding, [("f4", column) for column in POINTS.T])
    for cell in cells:
        if encoding == "ascii":
            body += " ".join(map(str, [len(cell), *cell])).encode() + b"\n"
        else:
            body += struct.pack(f">B{len(cell)}i", len(cell), *cell)
    source = open_ply(make_ply(encoding, elements, body))
    cloud = read_parts(source, 2)
    assert (cloud.positions == POINTS).all()
    if columns_said == 4:  # that is no size of these six
        assert source.scans[0].grid is None
        assert not cloud.attributes
        return
    assert source.scans[0].grid == (3, 2)
    assert cloud.attributes["row"].tolist() == [1, 0, -1]
    assert cloud.attributes["column"].tolist() == [0, 1, -1]


def test_a_grid_of_other_vertices_is_refused(make_ply: Make) -> None:
    elements = f"obj_info num_cols 1\nobj_info num_rows 1\nelement vertex 1\n{XYZ}"
    path = make_ply("ascii", f"{elements}element range_grid 1\n{FACES}", "1 2 3\n1 1\n")
    with pytest.raises(InputError, match="names vertices beyond the 1 of the file"):
        read_parts(open_ply(path), 2)
