"""Nothing is taken for what it is not: clouds of a torus whose columns hold something else."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import open_points, read_whole
from hpcapp.io.batches import join_points
from hpcapp.io.points.point_source import PointSource
from hpcapp.io.points.recognition import recognise

Source = Callable[..., PointSource]

POINTS = 3000
UTM = np.array([4.5e5, 5.4e6, 300.0])


def make_torus(points: int = POINTS) -> tuple[FloatArray, FloatArray]:
    """Return points of a torus of radii 1 and 0.4, and its normals there."""
    random = np.random.default_rng(3)
    u, v = random.uniform(0, 2 * np.pi, (2, points))
    normals = np.stack([np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v)], axis=1)
    middles = np.stack([np.cos(u), np.sin(u), np.zeros(points)], axis=1)
    return middles + 0.4 * normals, normals


TORUS, NORMALS = make_torus()
RANDOM = np.random.default_rng(5)
BYTES = RANDOM.integers(0, 256, (POINTS, 3))


def make_source(
    positions: FloatArray,
    normals: NDArray[np.floating] | NDArray[np.integer] | None = None,
    colours: NDArray[np.generic] | None = None,
    **more: Any,
) -> PointSource:
    """Return a source of a cloud that is in memory."""
    asked = None if normals is None else normals.astype(np.float64)
    cloud = PointCloud(positions, asked, colours, {"number": np.arange(len(positions))})

    def scan(rows: int) -> Iterator[PointCloud]:
        for start in range(0, max(len(cloud), 1), rows):
            yield cloud.take(np.arange(start, min(start + rows, len(cloud))))

    return PointSource(Path("a.made"), len(positions), True, normals is not None, scan, **more)


def read(source: PointSource) -> PointCloud:
    """Return all points of a source, which are the same in small parts and large ones."""
    found = join_points(list(source.chunks(700)))
    dropped = dict(source.findings.dropped)
    again = join_points(list(source.chunks(10**6)))
    assert source.findings.dropped == dropped
    assert np.array_equal(found.positions, again.positions, equal_nan=True)
    for one, other in ((found.normals, again.normals), (found.colours, again.colours)):
        assert (one is None) == (other is None)
        if one is not None and other is not None:
            assert np.array_equal(one, other)
    return found


def expect_warning(source: PointSource, *words: str) -> None:
    """Check that there is one warning, and that it names something."""
    assert len(source.findings.warnings) == 1
    for word in words:
        assert word in source.findings.warnings[0]


@pytest.mark.parametrize(
    ("raw", "bytes_"),
    [
        (BYTES.astype(np.uint8), BYTES),
        (BYTES.astype(np.uint16), BYTES),
        (BYTES.astype(np.uint16) * 256, BYTES),
        (BYTES.astype(np.uint16) * 257, BYTES),
        (BYTES.astype(np.float32) / 255, BYTES),
        (BYTES.astype(np.float64), BYTES),
        (BYTES / 255 * 1.06 - 0.03, None),
        (BYTES * 0.97 + 3.3, None),
    ],
)
def test_colours_become_bytes(raw: NDArray[np.generic], bytes_: NDArray[np.generic] | None) -> None:
    source = recognise(make_source(TORUS, colours=raw))
    colours = read(source).colours
    assert colours is not None
    assert colours.dtype == np.uint8
    if bytes_ is not None:
        assert np.array_equal(colours, bytes_)
    assert np.abs(colours.astype(int) - BYTES).max() <= 9
    assert not source.findings.warnings


def test_dark_colours_of_16_bits_are_no_bytes_where_a_bright_one_follows() -> None:
    points = 70_000
    colours = np.zeros((points, 3), np.uint16)
    colours[:, 1] = 40
    colours[-1] = 0xFF00
    source = recognise(make_source(make_torus(points)[0], colours=colours))
    assert [
        part.colours[-1].tolist() for part in source.chunks(points) if part.colours is not None
    ] == [[255] * 3]


def test_colours_that_are_all_zero_are_none() -> None:
    source = recognise(make_source(TORUS, colours=np.zeros((POINTS, 3), np.uint16)))
    assert read(source).colours is None
    assert not source.findings.warnings


def test_numbers_that_are_no_colours_are_left_out() -> None:
    source = recognise(make_source(TORUS, colours=RANDOM.normal(size=(POINTS, 3)) * 1e5))
    assert read(source).colours is None
    expect_warning(source, "colours")


def test_colours_of_points_without_a_place_do_not_count() -> None:
    positions, colours = TORUS.copy(), BYTES / 255
    positions[::7], colours[::7] = np.nan, np.nan
    source = recognise(make_source(positions, colours=colours))
    found = read(source).colours
    assert found is not None
    kept = np.arange(POINTS) % 7 > 0
    assert np.array_equal(found[kept], BYTES[kept])


@pytest.mark.parametrize("length", [1.0, 0.3, 127.0])
def test_normals_of_any_length_are_normals(length: float) -> None:
    source = recognise(make_source(TORUS, NORMALS * length))
    normals = read(source).normals
    assert normals is not None
    assert np.array_equal(normals, NORMALS * length)
    assert source.has_normals
    assert not source.findings.warnings


def test_normals_of_a_flat_or_tilted_patch_are_normals() -> None:
    """They have no negative component, as a closed cloud's cannot be."""
    plane = np.hstack([RANDOM.uniform(size=(POINTS, 2)), np.zeros((POINTS, 1))])
    for tilted in (np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.48, 0.64])):
        first = np.array([0.8, -0.36, -0.48])
        second = np.cross(tilted, first)
        axes = np.stack([first, second]) if tilted[0] else np.eye(3)[:2]
        source = recognise(make_source(plane[:, :2] @ axes, np.tile(tilted, (POINTS, 1))))
        assert source.has_normals
        assert not source.findings.warnings


@pytest.mark.parametrize("normal", [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
def test_the_same_vector_everywhere_is_a_normal_of_planes_only(normal: list[float]) -> None:
    source = recognise(make_source(TORUS, np.tile(normal, (POINTS, 1))))
    assert not source.has_normals
    expect_warning(source, "normal")
    flat = TORUS * (np.array(normal) == 0)
    assert recognise(make_source(flat, np.tile(normal, (POINTS, 1)))).has_normals


def test_zeros_are_no_normals() -> None:
    source = recognise(make_source(TORUS, np.zeros((POINTS, 3))))
    assert not source.has_normals
    assert read(source).normals is None
    expect_warning(source, "normal", "zero")


@pytest.mark.parametrize("most", [1, 255])
def test_encoded_normals_are_decoded(most: int) -> None:
    encoded = (NORMALS + 1) / 2 * most
    source = recognise(make_source(TORUS, np.rint(encoded) if most > 1 else encoded))
    normals = read(source).normals
    assert normals is not None
    assert np.allclose(normals, NORMALS, atol=2 / most if most > 1 else 1e-12)
    assert source.has_normals
    expect_warning(source, "normal")


def test_encoded_normals_of_unit_length_are_left_out() -> None:
    encoded = NORMALS + 1
    source = recognise(make_source(TORUS, encoded / np.linalg.norm(encoded, axis=1)[:, None]))
    assert not source.has_normals
    assert read(source).normals is None
    expect_warning(source, "normal")


@pytest.mark.parametrize("most", [1, 255])
def test_colours_in_the_place_of_normals_are_colours(most: int) -> None:
    source = recognise(make_source(TORUS, BYTES / 255 if most == 1 else BYTES))
    found = read(source)
    assert found.normals is None
    assert found.colours is not None
    assert np.array_equal(found.colours, BYTES)
    assert not source.has_normals
    expect_warning(source, "colour")


def test_normals_of_faces_are_not_doubted() -> None:
    source = recognise(make_source(TORUS, np.abs(NORMALS), normals_from="faces"))
    assert source.has_normals
    assert not source.findings.warnings


@pytest.mark.parametrize("share", [0.02, 0.9])
def test_missing_returns_at_the_origin_are_dropped(share: float) -> None:
    missing = RANDOM.uniform(size=POINTS) < share
    positions = np.where(missing[:, None], 0.0, TORUS + UTM)
    source = recognise(make_source(positions, NORMALS))
    found = read(source)
    assert source.findings.dropped == {"repeated": missing.sum()}
    assert np.array_equal(found.positions, (TORUS + UTM)[~missing])
    assert np.array_equal(found.attributes["number"], np.flatnonzero(~missing))
    expect_warning(source, "origin")


@pytest.mark.parametrize("missing", [1, 500])
def test_missing_returns_behind_all_that_was_looked_at_are_dropped(missing: int) -> None:
    positions = make_torus(200_000)[0] + UTM
    source = recognise(make_source(np.vstack([positions, np.zeros((missing, 3))])))
    assert sum(len(part) for part in source.chunks(30_000)) == len(positions)
    assert source.findings.dropped == {"repeated": missing}
    expect_warning(source, "origin")


def test_a_point_at_the_origin_is_one_where_others_are_near() -> None:
    source = recognise(make_source(np.vstack([TORUS, np.zeros((1, 3))])))
    assert len(read(source)) == POINTS + 1
    assert not source.findings.warnings


def test_missing_returns_at_another_place_are_dropped() -> None:
    missing = np.arange(POINTS) % 3 == 0
    positions = np.where(missing[:, None], [7.5, -2.0, 1.25], TORUS)
    source = recognise(make_source(positions, NORMALS))
    assert len(read(source)) == POINTS - missing.sum()
    assert source.findings.dropped == {"repeated": missing.sum()}
    expect_warning(source, "same", "7.5")


@pytest.mark.parametrize("times", [2, 5, 40])
def test_points_that_all_come_so_many_times_are_no_missing_returns(times: int) -> None:
    positions = np.repeat(np.vstack([TORUS[:500], [[0.0, 0.0, 0.0]]]), times, axis=0)
    source = recognise(make_source(positions))
    assert len(read(source)) == 501 * times
    assert not source.findings.dropped
    assert not source.findings.warnings


def test_what_a_reader_dropped_before_is_counted_once() -> None:
    plain = make_source(TORUS)
    plain.findings.drop("withheld", 4)
    source = recognise(plain)
    read(source)
    assert source.findings.dropped == {"withheld": 4}


@pytest.mark.parametrize(
    "more",
    [
        {"unit": "degree"},
        {"crs": "EPSG:4326"},
        {"crs": 'GEOGCS["WGS 84",DATUM["WGS_1984"]]'},
        {"columns": ("lon", "lat", "height")},
        {},
    ],
)
def test_degrees_are_told(more: dict[str, Any]) -> None:
    positions = TORUS * (1e-5, 1e-5, 1.0) + (7.0, 46.0, 500.0)
    source = recognise(make_source(positions, **more))
    expect_warning(source, "degree")
    assert source.unit == "degree"
    assert np.array_equal(read(source).positions, positions)


def test_a_pole_is_not_in_degrees() -> None:
    source = recognise(make_source(TORUS * np.array([0.1, 0.1, 40.0]) + 5.0))
    assert not source.findings.warnings


@pytest.mark.parametrize(
    "more", [{"unit": "m"}, {"crs": 'PROJCS["UTM 32",GEOGCS["WGS 84"]]'}, {"columns": ("x",)}]
)
def test_metres_are_no_degrees(more: dict[str, Any]) -> None:
    source = recognise(make_source(TORUS + np.array([7.0, 46.0, 500.0]), **more))
    assert not source.findings.warnings
    assert source.unit == more.get("unit")


@pytest.mark.parametrize("points", [0, 1, 5])
def test_a_few_points_are_as_they_are(points: int) -> None:
    normals = np.tile([0.6, 0.0, 0.8], (points, 1))
    source = recognise(make_source(np.zeros((points, 3)), normals))
    assert len(read(source)) == points
    assert not source.findings.warnings


def write_binary(path: Path, positions: FloatArray, normals: FloatArray | None, rgb: str) -> Path:
    """Write a binary PLY with colours of a type."""
    kinds = {"uchar": "u1", "ushort": "<u2"}
    fields = [(name, "<f8") for name in ("x", "y", "z")]
    fields += [(name, "<f4") for name in ("nx", "ny", "nz")] if normals is not None else []
    fields += [(name, kinds[rgb]) for name in ("red", "green", "blue")]
    rows = np.zeros(len(positions), fields)
    for axis in range(3):
        rows["xyz"[axis]] = positions[:, axis]
        rows[("red", "green", "blue")[axis]] = BYTES[: len(positions), axis] * (
            257 if rgb == "ushort" else 1
        )
        if normals is not None:
            rows[f"n{'xyz'[axis]}"] = normals[:, axis]
    words = {"<f8": "double", "<f4": "float", "u1": "uchar", "<u2": "ushort"}
    header = "".join(f"property {words[kind]} {name}\n" for name, kind in fields)
    start = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{header}end_header\n"
    )
    path.write_bytes(start.encode() + rows.tobytes())
    return path


def test_records_are_used_where_points_are_as_they_say(tmp_path: Path) -> None:
    source = open_points(write_binary(tmp_path / "a.ply", TORUS, NORMALS, "uchar"))
    assert source.records is not None
    assert source.records.normals
    assert source.records.colours
    source.check()


def test_records_have_no_normals_where_these_are_none(tmp_path: Path) -> None:
    source = open_points(write_binary(tmp_path / "a.ply", TORUS, 0 * NORMALS, "uchar"))
    assert source.records is not None
    assert not source.records.normals
    assert source.records.read(0, 3).normals is None


@pytest.mark.parametrize(
    ("positions", "normals", "rgb"),
    [
        (TORUS, NORMALS, "ushort"),
        (TORUS, (NORMALS + 1) / 2, "uchar"),
        (TORUS * (np.arange(POINTS) % 4 > 0)[:, None], NORMALS, "uchar"),
    ],
)
def test_a_file_is_parsed_where_its_records_say_something_else(
    tmp_path: Path, positions: FloatArray, normals: FloatArray, rgb: str
) -> None:
    source = open_points(write_binary(tmp_path / "a.ply", positions, normals, rgb))
    assert source.records is None
    kept = positions.any(axis=1)
    found = read_whole(source)
    assert np.array_equal(found.positions, TORUS[kept])
    assert found.normals is not None
    assert np.allclose(found.normals, NORMALS[kept], atol=1e-6)
    assert found.colours is not None
    assert np.array_equal(found.colours, BYTES[kept])


def test_a_sample_of_a_large_file_is_from_all_of_it(tmp_path: Path) -> None:
    """Rows of missing returns that fill its last part only are found."""
    points = 200_000
    positions, normals = make_torus(points)
    positions[-points // 10 :] = 0
    rows = np.hstack([positions, normals]).astype("<f4")
    header = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    start = f"ply\nformat binary_little_endian 1.0\nelement vertex {points}\n{header}end_header\n"
    (tmp_path / "a.ply").write_bytes(start.encode() + rows.tobytes())
    source = open_points(tmp_path / "a.ply")
    assert sum(len(part) for part in source.chunks(50_000)) == points * 9 // 10
    assert source.findings.dropped == {"repeated": points // 10}


def test_a_source_without_normals_has_none_to_judge() -> None:
    source = recognise(replace(make_source(TORUS), has_normals=False))
    assert not source.has_normals
    assert not source.findings.warnings


@pytest.mark.parametrize("scale", [1e-300, 1e-9, 1.0, 1e9, 1e300])
def test_normals_of_one_octant_are_judged_by_the_surface_at_any_scale(scale: float) -> None:
    directions = np.abs(np.random.default_rng(0).normal(size=(POINTS, 3)))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    kept = read(recognise(make_source(scale * directions, directions)))
    assert kept.normals is not None
    np.testing.assert_array_equal(kept.normals, directions)
    off = read(recognise(make_source(scale * directions, directions[::-1].copy())))
    assert off.normals is None


@pytest.mark.parametrize(
    ("more", "factor", "shift", "is_told"),
    [
        ({"unit": "m", "format": "E57"}, 2000.0, 0.0, True),
        ({"format": "LAZ 1.4, point format 6"}, 2000.0, 0.0, True),
        ({"unit": "m", "format": "E57"}, 2000.0, 0.25, False),  # not whole
        ({"unit": "m", "format": "E57"}, 20.0, 0.0, False),  # voxels, or a small object
        ({"unit": "mm", "format": "PLY, binary"}, 2000.0, 0.0, False),
        ({"format": "PLY, binary"}, 2000.0, 0.0, False),
    ],
)
def test_whole_metres_may_be_millimetres(
    more: dict[str, Any], factor: float, shift: float, is_told: bool
) -> None:
    source = recognise(make_source(np.rint(factor * TORUS) + shift, **more))
    told = [line for line in source.findings.warnings if "if they are millimetres" in line]
    assert len(told) == is_told


@pytest.mark.parametrize("most", [1.0, 255.0])
def test_points_without_a_colour_are_white(most: float) -> None:
    colours = np.rint(BYTES / 255 * most) if most > 1 else BYTES / 255
    colours[:7] = np.nan
    (part,) = recognise(make_source(TORUS, colours=colours)).chunks(POINTS)
    assert part.colours is not None
    assert part.colours[:7].tolist() == [[255, 255, 255]] * 7
    assert (part.colours[7:] == BYTES[7:]).all()
