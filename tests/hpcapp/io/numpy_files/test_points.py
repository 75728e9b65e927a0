"""NumPy files as point clouds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from hpcapp.geometry.points import PointCloud
from hpcapp.io.numpy_files.points import open_npy
from hpcapp.io.numpy_files.writer import write_npz_points
from hpcapp.io.points.point_source import read_whole
from hpccomponent.errors import InputError

RANDOM = np.random.default_rng(3)
POSITIONS = RANDOM.normal(size=(50, 3))
NORMALS = POSITIONS / np.linalg.norm(POSITIONS, axis=1)[:, None]
COLOURS = RANDOM.integers(0, 256, (50, 3)).astype(np.uint8)
INTENSITY = np.arange(50) + 0.5


def save(path: Path, array: NDArray[np.generic]) -> Path:
    np.save(path, array)
    return path


def read(path: Path) -> PointCloud:
    return read_whole(open_npy(path))


@pytest.mark.parametrize("dtype", ["<f8", ">f8", "<f4", "<f2", "<i4"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_any_numbers_in_any_order(tmp_path: Path, dtype: str, order: Literal["C", "F"]) -> None:
    points = np.asarray((POSITIONS * 100).astype(dtype), order=order)
    source = open_npy(save(tmp_path / "a.npy", points))
    assert (read_whole(source).positions == points).all()
    assert [len(part) for part in source.chunks(20)] == [20, 20, 10]
    assert source.is_double == (dtype[1:] in ("f8", "i4"))
    assert (source.records is not None) == (order == "C")


def test_records_of_numpy_are_read_from_any_row_on(tmp_path: Path) -> None:
    table = np.hstack([POSITIONS, NORMALS, COLOURS])
    source = open_npy(save(tmp_path / "a.npy", table))
    assert source.records is not None
    part = source.records.read(7, 9)
    assert (part.positions == POSITIONS[7:9]).all()
    np.testing.assert_array_equal(part.normals, NORMALS[7:9])
    np.testing.assert_array_equal(part.colours, COLOURS[7:9])


@pytest.mark.parametrize(
    ("columns", "normals", "colours", "attributes"),
    [
        ([POSITIONS], False, False, []),
        ([POSITIONS, INTENSITY], False, False, ["intensity"]),
        ([POSITIONS, NORMALS], True, False, []),
        ([POSITIONS, COLOURS], False, True, []),
        ([POSITIONS, COLOURS / 255], False, True, []),
        ([POSITIONS, NORMALS, COLOURS], True, True, []),
        ([POSITIONS, INTENSITY, COLOURS], False, True, ["intensity"]),
    ],
)
def test_columns_are_told_by_their_values(
    tmp_path: Path,
    columns: list[NDArray[np.generic]],
    normals: bool,
    colours: bool,
    attributes: list[str],
) -> None:
    source = open_npy(save(tmp_path / "a.npy", np.column_stack(columns)))
    cloud = read_whole(source)
    assert (cloud.positions == POSITIONS).all()
    assert (cloud.normals is not None) == source.has_normals == normals
    assert (cloud.colours is not None) == colours
    assert list(cloud.attributes) == attributes


def test_fields_are_taken_by_their_names(tmp_path: Path) -> None:
    fields = [
        ("id", "u4"),
        ("xyz", "f4", 3),
        ("rgb", "u4"),
        ("Normal", "f8", (3,)),
        ("label", "S3"),
    ]
    records = np.zeros(50, fields)
    records["id"], records["xyz"], records["Normal"] = np.arange(50), POSITIONS, NORMALS
    records["rgb"] = (COLOURS.astype(np.uint32) << [16, 8, 0]).sum(axis=1)
    cloud = read(save(tmp_path / "a.npy", records))
    assert (cloud.positions == POSITIONS.astype(np.float32)).all()
    np.testing.assert_array_equal(cloud.normals, NORMALS)
    np.testing.assert_array_equal(cloud.colours, COLOURS)
    assert cloud.attributes["id"].tolist() == list(range(50))


def test_pictures_of_points_are_grids(tmp_path: Path) -> None:
    for saved in ("npy", "npz"):
        path = tmp_path / f"a.{saved}"
        grid = POSITIONS.reshape(5, 10, 3)
        if saved == "npy":
            np.save(path, grid)
        else:
            np.savez(path, points=grid, rgb=COLOURS.reshape(5, 10, 3), i=INTENSITY.reshape(5, 10))
        source = open_npy(path)
        assert source.scans[0].grid == (10, 5)
        cloud = read_whole(source)
        assert (cloud.positions == POSITIONS).all()
        assert (cloud.attributes["row"] * 10 + cloud.attributes["column"]).tolist() == [*range(50)]
        assert (cloud.colours is not None) == (saved == "npz")


@pytest.mark.parametrize("columns", [3, 6])
def test_swapped_axes_are_told(tmp_path: Path, columns: int) -> None:
    table = np.hstack([POSITIONS, NORMALS])[:, :columns]
    source = open_npy(save(tmp_path / "a.npy", table.T))
    assert (read_whole(source).positions == POSITIONS).all()
    assert f"shape ({columns}, 50)" in source.findings.warnings[0]


@pytest.mark.parametrize(
    "arrays",
    [
        {"points": POSITIONS, "normals": NORMALS, "colors": COLOURS, "intensity": INTENSITY},
        {"XYZ": POSITIONS, "normal": NORMALS, "rgb": COLOURS, "intensity": INTENSITY[:, None]},
        {"pos": np.hstack([POSITIONS, NORMALS]), "Colour": COLOURS, "intensity": INTENSITY},
    ],
)
@pytest.mark.parametrize("save_", [np.savez, np.savez_compressed])
def test_arrays_are_taken_by_their_names(
    tmp_path: Path, arrays: dict[str, NDArray[np.generic]], save_: Callable[..., None]
) -> None:
    save_(tmp_path / "a.npz", **arrays, unit="m", pose=np.eye(4))
    source = open_npy(tmp_path / "a.npz")
    cloud = read_whole(source)
    assert (cloud.positions == POSITIONS).all()
    np.testing.assert_array_equal(cloud.normals, NORMALS)
    np.testing.assert_array_equal(cloud.colours, COLOURS)
    assert {name: column.tolist() for name, column in cloud.attributes.items()} == {
        "intensity": INTENSITY.tolist()
    }
    assert len(source.findings.warnings) == 2  # of unit and pose


def test_coordinates_may_be_arrays_of_their_own(tmp_path: Path) -> None:
    x, y, z = POSITIONS.T
    np.savez(tmp_path / "a.npz", z=z, x=x, y=y)
    assert (read(tmp_path / "a.npz").positions == POSITIONS).all()


def test_a_written_cloud_comes_back(tmp_path: Path) -> None:
    origin = np.array([4.5e5, 5.4e6, 300.0])
    attributes = {"intensity": INTENSITY, "gps time": INTENSITY, "positions": COLOURS[:, 0]}
    cloud = PointCloud(POSITIONS, NORMALS, COLOURS, attributes, origin)
    write_npz_points(tmp_path / "a.npz", cloud)
    again = read(tmp_path / "a.npz")
    assert (again.positions + again.origin == POSITIONS + origin).all()
    np.testing.assert_array_equal(again.normals, NORMALS)
    np.testing.assert_array_equal(again.colours, COLOURS)
    assert again.colours is not None
    assert again.colours.dtype == np.uint8
    assert list(again.attributes) == ["intensity", "gps time", "positions_attribute"]
    write_npz_points(tmp_path / "b.npz", cloud)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (np.zeros((100, 100)), "100 columns"),
        (np.zeros((5, 2)), "2 columns"),
        (np.zeros(5), "shape"),
        (np.zeros((2, 3, 4, 5)), "shape"),
        (np.zeros((40, 50, 3), np.uint8), "a picture"),
        (np.zeros((5, 3), np.complex128), "complex128"),
        (np.array([["a", "b", "c"]]), "not of numbers"),
        (np.zeros(5, [("x", "f4"), ("y", "f4")]), "has no z"),
        (np.zeros(5, [("name", "S4")]), "without numbers"),
    ],
)
def test_what_is_no_cloud_is_refused(tmp_path: Path, array: NDArray[np.generic], said: str) -> None:
    with pytest.raises(InputError, match=said):
        read(save(tmp_path / "a.npy", array))


def test_pickles_are_never_opened(tmp_path: Path) -> None:
    objects = np.array([None, {}], object)
    np.save(tmp_path / "a.npy", objects, allow_pickle=True)
    np.savez(tmp_path / "a.npz", points=POSITIONS, extra=objects)
    for path in tmp_path.iterdir():
        with pytest.raises(InputError, match="Python objects, a pickle"):
            read(path)


def test_files_without_points(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", weights=np.arange(4))
    with pytest.raises(InputError, match="no array of points: it holds weights"):
        read(tmp_path / "a.npz")
    assert len(read(save(tmp_path / "b.npy", np.zeros((0, 3))))) == 0
    (tmp_path / "c.npy").touch()
    with pytest.raises(InputError, match="is empty"):
        read(tmp_path / "c.npy")


@pytest.mark.parametrize("suffix", ["npy", "npz"])
def test_a_file_that_is_cut_is_refused_wherever_it_is_cut(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    if suffix == "npy":
        np.save(path, POSITIONS)
    else:
        np.savez_compressed(path, points=POSITIONS)
    whole = path.read_bytes()
    for kept in range(0, len(whole) - 1, 7):
        path.write_bytes(whole[:kept])
        with pytest.raises(InputError, match=f"a.{suffix}"):
            read(path)


def test_what_follows_after_the_array_is_told(tmp_path: Path) -> None:
    path = save(tmp_path / "a.npy", POSITIONS)
    path.write_bytes(path.read_bytes() + b"more")
    source = open_npy(path)
    assert len(read_whole(source)) == 50
    assert source.findings.warnings == ["4 bytes follow after the array: they are left out"]
