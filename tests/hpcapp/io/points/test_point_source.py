"""A file that is read in parts holds the same points, and the same faults, as one read whole."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpcapp.geometry.point_records import PointRecords
from hpcapp.geometry.points import PointCloud
from hpcapp.io import PointSource, open_points, read_points, write_points
from hpcapp.io.points.point_source import Findings, keep_small
from hpccomponent.errors import InputError
from hpccomponent.protocol.codec import decode_values, encode_values

Make = Callable[..., Path]
ORDERS = [("binary_little_endian", "<"), ("binary_big_endian", ">")]
VERTEX = "property double x\nproperty float y\nproperty short id\nproperty float z\n"
NORMALS = "property float nx\nproperty float ny\nproperty float nz\n"
FACE = "property list uchar int vertex_indices\n"


def _join(source: PointSource, rows: int) -> PointCloud:
    parts = list(source.chunks(rows))
    assert all(len(part) == rows for part in parts[:-1])
    assert len(parts[-1]) <= rows
    columns = [[part.positions, part.normals, part.colours] for part in parts]
    joined: list[Any] = [
        np.concatenate(some) if some[0] is not None else None for some in zip(*columns, strict=True)
    ]
    positions, normals, colours = joined
    return PointCloud(positions, normals, colours)


def _assert_same(one: PointCloud, other: PointCloud) -> None:
    assert one.positions.tobytes() == (other.positions + other.origin).tobytes()
    for mine, its in ((one.normals, other.normals), (one.colours, other.colours)):
        assert (mine is None) == (its is None)
        if mine is not None and its is not None:
            assert mine.tobytes() == its.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".ply", ".xyz"])
@pytest.mark.parametrize("rows", [1, 7, 50, 1000])
@pytest.mark.parametrize("with_normals", [True, False])
@pytest.mark.parametrize("with_colors", [True, False])
def test_parts_are_the_whole(
    tmp_path: Path,
    cloud: PointCloud,
    suffix: str,
    rows: int,
    with_normals: bool,
    with_colors: bool,
) -> None:
    path = tmp_path / f"a{suffix}"
    some = PointCloud(
        cloud.positions,
        cloud.normals if with_normals else None,
        cloud.colours if with_colors else None,
    )
    write_points(path, some)
    source = open_points(path)
    assert source.has_normals == with_normals
    assert source.is_double == (suffix == ".xyz")
    assert source.count == (50 if suffix == ".ply" else None)
    _assert_same(_join(source, rows), some)
    _assert_same(_join(source, rows), read_points(path))  # a second time


@pytest.mark.slow
@pytest.mark.parametrize(("encoding", "order"), ORDERS)
@pytest.mark.parametrize("lists", [[(1, 2), (3, 4), (5, 6)], [(1,), (), (2, 3, 4)]])
@pytest.mark.parametrize("rows", [1, 2, 5])
def test_lists_anywhere(
    make_ply: Make, encoding: str, order: str, lists: list[tuple[int, ...]], rows: int
) -> None:
    """In front of the vertices, among them, and behind: of one length, or of different ones."""
    points = np.array([[1.5, 2.5, -3.5], [4.0, 5.0, 6.0], [-7.0, 8.0, 9.25]])
    strips = b"".join(struct.pack(f"{order}B{len(s)}i", len(s), *s) for s in lists)
    body = strips
    for s, (x, y, z) in zip(lists, points.tolist(), strict=True):
        body += struct.pack(f"{order}dfhfB{len(s)}i", x, y, 7, z, len(s), *s)
    elements = (
        f"element strip 3\n{FACE}element vertex 3\n{VERTEX}property list uchar int seen\n"
        f"element tail 3\n{FACE}"
    )
    path = make_ply(encoding, elements, body + strips)
    source = open_points(path)
    assert _join(source, rows).positions.tolist() == points.tolist()
    assert source.is_double
    if len({len(s) for s in lists}) == 1:
        assert source.records is not None
        assert source.records.read(1, 3).positions.tolist() == points[1:].tolist()
    else:
        assert source.records is None
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match="truncated: element 'tail'"):
        _join(open_points(path), rows)


@pytest.mark.parametrize("rows", [1, 2, 3, 100])
def test_ranges_are_runs_of_the_file(tmp_path: Path, cloud: PointCloud, rows: int) -> None:
    write_points(tmp_path / "a.ply", cloud)
    records = open_points(tmp_path / "a.ply").records
    assert records is not None
    (records,) = decode_values(*encode_values((records,)))
    assert isinstance(records, PointRecords)
    for start in range(0, len(cloud), rows):
        part = records.read(start, min(start + rows, len(cloud)))
        _assert_same(part, cloud.take(np.arange(start, min(start + rows, len(cloud)))))


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1, 2, 3, 100])
@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("short.ply", "ply\nformat ascii 1.0\nelement vertex 4\n{V}end_header\n1 2 3 4\n"),
        ("long.ply", "ply\nformat ascii 1.0\nelement vertex 1\n{V}end_header\n1 2 3 4\n1 2 3\n"),
        ("word.ply", "ply\nformat ascii 1.0\nelement vertex 2\n{V}end_header\n1 2 3 4\n1 2 3 a\n"),
        ("type.ply", "ply\nformat ascii 1.0\nelement vertex 2\n{V}end_header\n1 2 3 4\n1 2 .5 4\n"),
        ("half.ply", "ply\nformat ascii 1.0\nelement vertex 0\n{V}property float nx\nend_header\n"),
        ("word.xyz", "1 2 3\n1 2 3\n4 5 x\n"),
        ("columns.xyz", "1 2 3\n1 2 3\n4 5\n"),
        ("empty.csv", "1,2,3\n\n4,5\n"),
        (
            "cut.ptx",
            "1\n2\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 2 3\n",
        ),
    ],
)
def test_faults_are_found_after_the_last_part_at_the_latest(
    make_file: Make, name: str, content: str, rows: int
) -> None:
    path = make_file(name, content.replace("{V}", VERTEX))
    with pytest.raises(InputError) as whole:
        read_points(path)
    with pytest.raises(InputError) as parts:
        _join(open_points(path), rows)
    assert str(parts.value) == str(whole.value)


@pytest.mark.slow
@pytest.mark.parametrize("cut", [1, 5, 13])
@pytest.mark.parametrize("rows", [1, 3])
def test_a_binary_file_that_is_cut_or_too_long(
    tmp_path: Path, cloud: PointCloud, cut: int, rows: int
) -> None:
    path = tmp_path / "a.ply"
    write_points(path, cloud)
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    with pytest.raises(InputError, match="truncated: element 'vertex'"):
        open_points(path)
    path.write_bytes(whole + b"x" * cut)
    with pytest.raises(InputError, match="bytes follow after the last element"):
        _join(open_points(path), rows)
    with pytest.raises(InputError, match="bytes follow after the last element"):
        open_points(path).check()


def test_a_file_that_is_cut_while_it_is_read(tmp_path: Path, cloud: PointCloud) -> None:
    """Who meets it says the same, whichever range was asked for."""
    path = tmp_path / "a.ply"
    write_points(path, cloud)
    records = open_points(path).records
    assert records is not None
    path.write_bytes(path.read_bytes()[: records.start + records.length])
    assert len(records.read(0, 1)) == 1
    for start in range(len(cloud)):
        with pytest.raises(InputError, match=r"a\.ply: truncated: it has become shorter"):
            records.read(start, len(cloud))
    path.unlink()
    with pytest.raises(InputError, match=r"a\.ply: cannot be read"):
        records.read(0, 1)


def test_a_file_without_points_is_one_empty_part(make_ply: Make) -> None:
    for encoding in ("ascii", "binary_little_endian"):
        source = open_points(make_ply(encoding, f"element vertex 0\n{VERTEX}{NORMALS}", ""))
        parts = list(source.chunks(10))
        assert [len(part) for part in parts] == [0]
        assert parts[0].normals is not None
        assert len(read_points(source.path)) == 0


def test_a_file_that_goes_away_is_named(tmp_path: Path, cloud: PointCloud) -> None:
    write_points(tmp_path / "a.xyz", cloud)
    source = open_points(tmp_path / "a.xyz")
    source.path.unlink()
    with pytest.raises(InputError, match=r"a\.xyz: cannot be read"):
        list(source.chunks(10))


_MEASURE = """
import resource, sys
from hpcapp.io import open_points
source = open_points(sys.argv[1])
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(sum(len(part) for part in source.chunks(1 << 14)))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.slow
@pytest.mark.parametrize("where", ["points", "faces"])
def test_memory_does_not_grow_with_the_file(make_ply: Make, where: str) -> None:
    """Neither for the points, nor for a mesh's faces behind them, whose lists are counted."""
    points, faces = (4_000_000, 0) if where == "points" else (9, 1_500_000)
    elements = f"element vertex {points}\n{VERTEX}element face {faces}\n{FACE}"
    body = bytes(18 * points) + struct.pack("<B9i", 9, *range(9)) * faces
    path = make_ply("binary_little_endian", elements, body)
    command = [sys.executable, "-P", "-c", _MEASURE, str(path)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    read, kibibytes = map(int, done.stdout.split())
    assert read == points
    assert kibibytes < 20_000  # of a file of 50 to 70 MB


def test_a_small_file_is_decoded_once(tmp_path: Path) -> None:
    findings, passes = Findings(), []

    def scan(rows: int) -> Iterator[PointCloud]:
        passes.append(rows)
        findings.drop("noise", 2)
        yield PointCloud(np.arange(12.0).reshape(4, 3))

    source = keep_small(PointSource(tmp_path, 6, True, False, scan, findings=findings))
    for part in source.chunks(3):
        part.positions[:] = 0.0
    assert [part.positions.tolist() for part in source.chunks(3)] == [
        [[0, 1, 2], [3, 4, 5], [6, 7, 8]], [[9, 10, 11]]
    ]  # fmt: skip
    assert len(passes) == 1
    assert findings.dropped == {"noise": 2}
    large = PointSource(tmp_path, 1 << 20, True, False, scan)
    assert keep_small(large) is large
