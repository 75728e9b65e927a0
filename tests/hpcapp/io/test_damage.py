"""Whatever is done to a file, reading it ends in a value or in an InputError."""

from __future__ import annotations

import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io import drop_unusable, read_mesh, read_points, write_mesh, write_points
from hpccomponent.errors import InputError

HEADER = (
    "ply\nformat {} 1.0\nelement strip 2\nproperty list char int ids\nproperty short s\n"
    "element vertex 3\nproperty float x\nproperty int y\nproperty double z\nproperty uchar red\n"
    "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
)
BODY = struct.pack("<b2ihb1ih", 2, 7, 8, 9, 1, 7, 8) + struct.pack("<fidB", 1, 2, 3, 4) * 3
BINARY = HEADER.format("binary_little_endian").encode() + BODY
BINARY += struct.pack("<B3iB4i", 3, 0, 1, 2, 4, 0, 1, 2, 0)
ASCII = HEADER.format("ascii").encode() + b"2 7 8 9\n1 7 8\n" + b"1 2 3 4\n" * 3 + b"3 0 1 2\n" * 2
words = st.binary(max_size=4) | st.sampled_from(
    [
        b"nan",
        b"-1",
        b"1e999",
        b"4000000000",
        b"1_0",
        b"\n",
        b"\r",
        b" ",
        b",",
        b"#",
        b"element v 1\n",
    ]
)
damages = st.lists(st.tuples(st.floats(0, 1), st.integers(0, 6), words), max_size=3)


def damage(content: bytes, cuts: list[tuple[float, int, bytes]]) -> bytes:
    """Put words in place of some bytes."""
    for where, removed, word in cuts:
        at = int(where * len(content))
        content = content[:at] + word + content[at + removed :]
    return content


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=150, deadline=None
)
@given(st.sampled_from([BINARY, ASCII]), damages, st.floats(0, 1))
def test_damaged_ply(
    tmp_path: Path, whole: bytes, cuts: list[tuple[float, int, bytes]], kept: float
) -> None:
    path = tmp_path / "damaged.ply"
    content = damage(whole, cuts)
    path.write_bytes(content[: int(kept * 2 * len(content))])  # half of them whole
    for read in (read_points, read_mesh):
        with suppress(InputError):
            read(path)


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None
)
@given(st.sampled_from([".obj", ".off", ".stl", ".xyz"]), damages)
def test_other_damaged_files(
    tmp_path: Path, tetrahedron: Mesh, suffix: str, cuts: list[tuple[float, int, bytes]]
) -> None:
    path = tmp_path / f"damaged{suffix}"
    if suffix == ".xyz":
        write_points(path, PointCloud(tetrahedron.vertices, tetrahedron.vertices))
    else:
        write_mesh(path, tetrahedron)
    path.write_bytes(damage(path.read_bytes(), cuts))
    with suppress(InputError):
        if suffix == ".xyz":
            drop_unusable(read_points(path))
        else:
            read_mesh(path)


PCD = (
    b"VERSION 0.7\nFIELDS x y z rgb _ n\nSIZE 4 4 8 4 1 2\nTYPE F F F U U I\nCOUNT 1 1 1 1 3 1\n"
    b"WIDTH 2\nHEIGHT 2\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 4\nDATA "
)
PCDS = [
    PCD + b"ascii\n" + b"1 2 3.5 4000000000 0 0 0 7\n" * 4,
    PCD + b"binary\n" + struct.pack("<ffdI3Bh", 1, 2, 3.5, 9, 0, 0, 0, 7) * 4,
    PCD + b"binary_compressed\n" + struct.pack("<II", 8, 100) + b"\x00a\xe0\x5a\x00",
]


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=150, deadline=None
)
@given(st.sampled_from(PCDS), damages, st.floats(0, 1))
def test_damaged_pcd(
    tmp_path: Path, whole: bytes, cuts: list[tuple[float, int, bytes]], kept: float
) -> None:
    path = tmp_path / "damaged.pcd"
    content = damage(whole, cuts)
    path.write_bytes(content[: int(kept * 2 * len(content))])
    with suppress(InputError):
        read_points(path)


def save_numpy(path: Path, kind: str) -> None:
    """Save a small cloud in one of NumPy's ways."""
    table = np.arange(30.0).reshape(5, 6)
    if kind == "npz":
        np.savez(path, points=table[:, :3], rgb=table[:, 3:], label=np.arange(5))
    elif kind == "packed":
        np.savez_compressed(path, points=table)
    else:
        fields = [("x", "f4"), ("y", "i2"), ("z", "f8"), ("rgb", "u4")]
        np.save(path, np.zeros(5, fields) if kind == "records" else table)


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=150, deadline=None
)
@given(st.sampled_from(["npy", "records", "npz", "packed"]), damages, st.floats(0, 1))
def test_damaged_numpy(
    tmp_path: Path, kind: str, cuts: list[tuple[float, int, bytes]], kept: float
) -> None:
    path = tmp_path / ("damaged.npy" if kind in ("npy", "records") else "damaged.npz")
    save_numpy(path, kind)
    content = damage(path.read_bytes(), cuts)
    path.write_bytes(content[: int(kept * 2 * len(content))])
    with suppress(InputError):
        read_points(path)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(*[st.floats()] * 6), max_size=30))
def test_any_numbers_are_judged(rows: list[tuple[float, ...]]) -> None:
    table = np.array(rows, np.float64).reshape(-1, 6)
    with suppress(InputError):
        cloud, dropped = drop_unusable(PointCloud(table[:, :3], table[:, 3:]))
        assert len(cloud) + dropped.total == len(rows)
        assert cloud.normals is not None
        assert np.linalg.norm(cloud.normals, axis=1) == pytest.approx(1.0)
