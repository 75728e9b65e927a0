import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hpcapp.io.formats import read_mesh, read_points
from hpcapp.io.ply.body import read_body
from hpcapp.io.ply.header import SCALAR_TYPES, read_header
from hpccomponent.errors import InputError

Make = Callable[..., Path]
ORDERS = [("binary_little_endian", "<"), ("binary_big_endian", ">")]
XYZ = "property float x\nproperty float y\nproperty float z\n"
FACES = "property list uchar int vertex_indices\n"
POINTS = np.array([[1.5, 2.5, -3.5], [4.0, 5.0, 6.0], [-7.0, 8.0, 9.25]])


def packed(order: str, points: np.ndarray = POINTS) -> bytes:
    return points.astype(order + "f4").tobytes()


@pytest.mark.parametrize(("encoding", "order"), ORDERS)
def test_both_byte_orders(make_ply: Make, encoding: str, order: str) -> None:
    path = make_ply(encoding, f"element vertex 3\n{XYZ}", packed(order))
    assert (read_points(path).positions == POINTS).all()


@pytest.mark.parametrize(("encoding", "order"), ORDERS)
@pytest.mark.parametrize("lists", [[(1, 2), (3, 4)], [(1,), (), (2, 3, 4)]])
def test_lists_and_foreign_elements_before_the_vertices(
    make_ply: Make, encoding: str, order: str, lists: list[tuple[int, ...]]
) -> None:
    elements = (
        "element camera 1\nproperty double fov\nelement view 0\nproperty list int int ids\n"
        f"element strip {len(lists)}\nproperty short a\nproperty list ushort int b\n"
        f"property char c\nproperty list uchar double d\nelement vertex 3\n{XYZ}"
        "element tail 1\nproperty uchar last\n"
    )
    body = struct.pack(order + "d", 0.5)
    for b in lists:
        body += struct.pack(f"{order}hH{len(b)}ibB{len(b)}d", 1, len(b), *b, 2, len(b), *b)
    path = make_ply(encoding, elements, body + packed(order) + b"\x07")
    assert (read_points(path).positions == POINTS).all()


@pytest.mark.parametrize("lists", [[(1, 2), (3, 4), (5, 6)], [(1, 2), (), (3,)]])
def test_vertices_may_have_lists_themselves(make_ply: Make, lists: list[tuple[int, ...]]) -> None:
    elements = f"element vertex 3\nproperty list uchar int seen\n{XYZ}"
    rows = zip(lists, POINTS, strict=True)
    body = b"".join(struct.pack(f"<B{len(s)}i3f", len(s), *s, *p) for s, p in rows)
    path = make_ply("binary_little_endian", elements, body)
    vertex = read_body(path, read_header(path), {"vertex"})["vertex"]
    assert [vertex.scalars[name].tolist() for name in "xyz"] == POINTS.T.tolist()
    assert vertex.lists["seen"].lengths.tolist() == [len(s) for s in lists]
    assert vertex.lists["seen"].values.tolist() == [n for s in lists for n in s]


Table = tuple[str, list[tuple[str, list[float]]]]


@st.composite
def tables(draw: st.DrawFn) -> Table:
    """An element of random scalar types, and its columns."""
    types = draw(st.lists(st.sampled_from(sorted(SCALAR_TYPES)), min_size=1, max_size=5))
    count = draw(st.integers(0, 5))
    columns = []
    for name in types:
        dtype = np.dtype(SCALAR_TYPES[name])
        if dtype.kind == "f":
            value = st.floats(width=32 if dtype.itemsize == 4 else 64)
        else:
            limits = np.iinfo(dtype)
            value = st.integers(int(limits.min), int(limits.max))
        columns.append((name, draw(st.lists(value, min_size=count, max_size=count))))
    return draw(st.sampled_from("<>")), columns


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None
)
@given(tables())
def test_any_scalars_come_back(make_ply: Make, drawn: Table) -> None:
    order, columns = drawn
    fields = [(f"p{i}", order + SCALAR_TYPES[name]) for i, (name, _) in enumerate(columns)]
    rows = np.array(list(zip(*(values for _, values in columns), strict=True)), fields)
    lines = "".join(f"property {name} p{i}\n" for i, (name, _) in enumerate(columns))
    encoding = {o: e for e, o in ORDERS}[order]
    path = make_ply(encoding, f"element thing {len(rows)}\n{lines}", rows.tobytes())
    found = read_body(path, read_header(path), {"thing"})["thing"].scalars
    for i, (_, values) in enumerate(columns):
        np.testing.assert_array_equal(found[f"p{i}"], np.array(values, fields[i][1]))


@pytest.mark.parametrize("kept", [0, 1, 12, 35])
def test_truncated_vertices(make_ply: Make, kept: int) -> None:
    path = make_ply("binary_little_endian", f"element vertex 3\n{XYZ}", packed("<")[:kept])
    with pytest.raises(InputError, match=r"truncated: element 'vertex' \(3 rows\)"):
        read_points(path)


@pytest.mark.parametrize("lists", [[(0, 1, 2), (2, 1, 0)], [(0, 1, 2), (0, 1, 2, 1)]])
@pytest.mark.parametrize("cut", [1, 4, 12, 13])
def test_truncated_lists(make_ply: Make, lists: list[tuple[int, ...]], cut: int) -> None:
    body = packed("<") + b"".join(struct.pack(f"<B{len(f)}i", len(f), *f) for f in lists)
    elements = f"element vertex 3\n{XYZ}element face 2\n{FACES}"
    path = make_ply("binary_little_endian", elements, body[:-cut])
    with pytest.raises(InputError, match="truncated: element 'face'"):
        read_mesh(path)


@pytest.mark.parametrize("elements", [XYZ, FACES + XYZ])
def test_a_count_of_four_billion_allocates_nothing(make_ply: Make, elements: str) -> None:
    path = make_ply(
        "binary_little_endian", f"element vertex 4000000000\n{elements}", packed("<") * 50
    )
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="truncated"):
            read_points(path)
        assert tracemalloc.get_traced_memory()[1] < 4e6  # the header's 1 MiB, and change
    finally:
        tracemalloc.stop()


def test_a_count_too_small_is_found_out(make_ply: Make) -> None:
    body = packed("<") + struct.pack("<B3i", 3, 0, 1, 2)
    faces = f"element face 1\n{FACES}"
    path = make_ply("binary_little_endian", f"element vertex 2\n{XYZ}{faces}", body)
    with pytest.raises(InputError, match=r"follow after the last element|truncated"):
        read_points(path)


@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
def test_a_line_end_after_the_body_is_no_trailing_data(make_ply: Make, end: bytes) -> None:
    path = make_ply("binary_little_endian", f"element vertex 3\n{XYZ}", packed("<") + end)
    assert len(read_points(path)) == 3


@pytest.mark.parametrize("lengths", [(-1, 2), (1, -1)])
def test_a_list_of_negative_length(make_ply: Make, lengths: tuple[int, int]) -> None:
    elements = "element strip 2\nproperty list char uchar ids\nelement vertex 0\n" + XYZ
    path = make_ply(
        "binary_little_endian", elements, struct.pack("<bBbB", lengths[0], 7, lengths[1], 7)
    )
    with pytest.raises(InputError, match=r"row [01]: a list of negative length"):
        read_points(path)


def test_a_header_with_lone_returns_may_end_before_a_line_feed(make_ply: Make) -> None:
    points = np.frombuffer(b"\n\0\0\0" * 3, "<f4").reshape(1, 3)
    path = make_ply("binary_little_endian", f"element vertex 1\n{XYZ}", points.tobytes(), "\r")
    assert (read_points(path).positions == points).all()
