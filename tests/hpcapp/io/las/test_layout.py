"""Fields of the point formats, beside laspy's own."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.points import PointCloud
from hpcapp.io import PointSource, open_points
from hpcapp.io.las.points import open_las
from hpccomponent.errors import InputError

laspy = pytest.importorskip("laspy", reason="laspy is not installed")

MakeLas = Callable[..., Path]


def read(path: Path) -> tuple[PointSource, PointCloud]:
    source = open_las(path)
    (part,) = source.chunks(1000)
    return source, part


def describe(
    name: bytes, kind: int, options: int = 0, scale: float = 0, offset: float = 0
) -> bytes:
    numbers = struct.pack("<6d", *[scale] * 3, *[offset] * 3)
    return struct.pack("<2xBB32s76x48s32x", kind, options, name, numbers)


@pytest.mark.parametrize("point_format", range(11))
def test_every_format(tmp_path: Path, point_format: int) -> None:
    random = np.random.default_rng(point_format)
    header = laspy.LasHeader(point_format=point_format)
    header.scales, header.offsets = np.array([0.01, 0.001, 0.25]), np.array([5e5, -4e6, 0.0])
    written = laspy.LasData(header, laspy.ScaleAwarePointRecord.zeros(20, header=header))
    for axis in "XYZ":
        written[axis] = random.integers(-(1 << 31), 1 << 31, 20)
    written.intensity = random.integers(0, 1 << 16, 20)
    written.return_number = random.integers(0, 8, 20)
    written.number_of_returns = random.integers(0, 8, 20)
    written.classification = random.integers(0, 7, 20)
    written.user_data = random.integers(0, 256, 20)
    written.point_source_id = random.integers(0, 1 << 16, 20)
    angles = random.integers(-90, 91, 20)
    if point_format < 6:
        written.scan_angle_rank = angles
    else:
        written.scan_angle = np.rint(angles / 0.006)
    names = set(written.point_format.dimension_names)
    if "gps_time" in names:
        written.gps_time = random.random(20) * 1e9
    for name in {"red", "green", "blue", "nir"} & names:
        written[name] = random.integers(0, 1 << 16, 20)
    written.write(tmp_path / "a.las")

    source, cloud = read(tmp_path / "a.las")
    assert source.count == 20
    assert source.format.endswith(f"point format {point_format}")
    assert cloud.positions.tobytes() == np.ascontiguousarray(written.xyz).tobytes()
    for name in ("intensity", "return_number", "number_of_returns", "classification",
                 "user_data", "point_source_id"):  # fmt: skip
        assert (cloud.attributes[name] == written[name]).all(), name
    np.testing.assert_allclose(cloud.attributes["scan_angle"], angles, atol=0.0031)
    assert ("gps_time" in cloud.attributes) == ("gps_time" in names)
    if "gps_time" in names:
        assert (cloud.attributes["gps_time"] == written.gps_time).all()
    assert (cloud.colours is None) == ("red" not in names)
    if cloud.colours is not None:
        assert cloud.colours.dtype == np.uint16
        for i, name in enumerate(("red", "green", "blue")):
            assert (cloud.colours[:, i] == written[name]).all()
    if "nir" in names:
        assert (cloud.attributes["near_infrared"] == written.nir).all()


def test_extra_bytes(make_las: MakeLas) -> None:
    described = [
        describe(b"unknown", 0, options=3),
        describe(b"Reflectance", 4, options=24, scale=0.5, offset=10.0),
        describe(b"Intensity", 5),  # of the same name as a field
        describe(b"pair", 13),
        describe(b"plain", 3, options=0, scale=0.5),  # a scale that does not hold
        describe(b"beyond", 10),  # the record is too short for it
    ]
    point = struct.pack("<3i8x", 0, 0, 0) + struct.pack("<3xhI2HH", -4, 7, 1, 2, 9)
    path = make_las([point], vlrs=[(b"LASF_Spec", 4, b"".join(described))])
    attributes = read(path)[1].attributes
    expected = {"Reflectance": 8.0, "intensity": 0, "intensity_2": 7, "plain": 9}
    expected |= {"pair_0": 1, "pair_1": 2}
    assert {name: attributes[name].item() for name in expected} == expected
    assert "beyond" not in attributes
    assert "unknown" not in attributes


def test_bytes_that_are_not_described(make_las: MakeLas) -> None:
    path = make_las([struct.pack("<3i8x", i, i, i) + b"abcd" for i in range(4)], scale=1, offset=0)
    assert read(path)[1].positions[:, 0].tolist() == [0, 1, 2, 3]


def test_normals_in_extra_bytes(make_las: MakeLas) -> None:
    described = b"".join(describe(b"Normal" + axis, 9) for axis in (b"X", b"Y", b"Z"))
    point = struct.pack("<3i8x3f", 0, 0, 0, 0.0, 0.6, -0.8)
    source, cloud = read(make_las([point], vlrs=[(b"LASF_Spec", 4, described)]))
    assert source.has_normals
    assert cloud.normals is not None
    np.testing.assert_allclose(cloud.normals, [[0, 0.6, -0.8]], atol=1e-7)
    assert not {"nx", "ny", "nz"} & set(cloud.attributes)


@pytest.mark.parametrize("damage", [b"", b"\0" * 191, b"\xff" * 192 * 3])
def test_damaged_descriptions(make_las: MakeLas, damage: bytes) -> None:
    path = make_las([struct.pack("<3i8x9x", 1, 2, 3)], vlrs=[(b"LASF_Spec", 4, damage)])
    assert len(read(path)[1]) == 1


def test_unknown_format(make_las: MakeLas) -> None:
    with pytest.raises(InputError, match="point format 11 is unknown"):
        open_points(make_las([bytes(80)], 11))


def test_records_too_short(make_las: MakeLas) -> None:
    with pytest.raises(InputError, match="points of format 1 have 28 bytes, not 27"):
        open_points(make_las([bytes(27)], 1))
