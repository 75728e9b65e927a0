"""What is asked for by --box and --around, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from hpcapp.cli import hpcapp
from hpcapp.geometry.points import PointCloud
from hpcapp.io import open_points, read_points, write_points
from hpcapp.io.points.inputs import gather_points
from hpcapp.parts.crop import make_crop, parse_crop
from hpccomponent.errors import InputError, UsageError


@pytest.fixture
def heap(tmp_path: Path) -> Path:
    """Points on a map, heights in metres beside feet."""
    random = np.random.default_rng(1)
    places = random.random((5_000, 3)) * (100.0, 50.0, 10.0) + (2_000_000.0, 500_000.0, 300.0)
    path = tmp_path / "heap.ply"
    write_points(path, PointCloud(places), "EPSG:2229", "ft", height_unit="m")
    return path


@pytest.mark.parametrize(
    ("box", "around", "said"),
    [
        ("1,2,3", None, "not 6 numbers"),
        ("1,2,3,4,5,nan", None, "not 6 numbers"),
        ("a,b", None, "no numbers"),
        ("0,0,0,1,0,1", None, "nothing is between them"),
        (None, "1,2,3,0", "R is 0"),
        (None, "1,2,3,-1", "R is -1"),
        (None, "1,2,3", "not 4 numbers"),
        ("0,0,0,1,1,1", "1,2,3,4", "exclude each other"),
    ],
)
def test_what_holds_nothing_is_refused(box: str | None, around: str | None, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        parse_crop(box, around)


@pytest.mark.parametrize("rows", [1, 100, 1 << 20])
def test_points_in_a_box_are_those_of_the_file(heap: Path, rows: int) -> None:
    whole = read_points(heap)
    places = whole.positions + whole.origin
    crop = make_crop((2_000_040, 500_030, 304, 2_000_060, 500_010, 309), None)
    parts = list(crop.take(open_points(heap)).chunks(rows))
    inside = ((places >= (2_000_040, 500_010, 304)) & (places <= (2_000_060, 500_030, 309))).all(1)
    assert np.array_equal(np.concatenate([part.positions for part in parts]), places[inside])
    assert all(len(part) == rows for part in parts[:-1])


def test_a_radius_is_in_the_unit_of_x_and_y(heap: Path) -> None:
    whole = read_points(heap)
    arms = whole.positions + whole.origin - (2_000_050, 500_025, 305)
    near = np.linalg.norm(arms * (1.0, 1.0, 1.0 / 0.3048), axis=1) <= 12.0
    source = make_crop(None, (2_000_050, 500_025, 305, 12)).take(open_points(heap))
    assert sum(map(len, source.chunks(1000))) == near.sum() > 0
    same = source.isotropic()
    assert sum(map(len, same.chunks(1000))) == near.sum()


def test_a_place_without_points_is_told_with_the_extent(heap: Path) -> None:
    source = make_crop((0, 0, 0, 1, 1, 1), None).take(open_points(heap))
    with pytest.raises(InputError, match=r"no points in the box from 0 0 0 to 1 1 1") as found:
        list(source.chunks(1000))
    assert "lie from 2000000" in found.value.advice
    assert "500049.9" in found.value.advice


def test_info_and_convert_take_the_part(heap: Path, tmp_path: Path) -> None:
    part = tmp_path / "part.ply"
    box = "2000040,500010,304,2000060,500030,309"
    run = CliRunner().invoke(hpcapp, ["convert", str(heap), "-o", str(part), "--box", box])
    assert run.exit_code == 0
    shown = CliRunner().invoke(hpcapp, ["info", str(heap), "--box", box])
    count = len(read_points(part))
    assert f"{count}" in next(row for row in shown.output.splitlines() if row[:6] == "points")


def test_of_several_files_only_what_is_asked_for_is_joined(heap: Path, tmp_path: Path) -> None:
    west, east = tmp_path / "west.ply", tmp_path / "east.ply"
    whole = read_points(heap)
    places = whole.positions + whole.origin
    is_west = places[:, 0] < 2_000_030
    write_points(west, PointCloud(places[is_west]))  # without units: those of the other
    write_points(east, PointCloud(places[~is_west]), "EPSG:2229", "ft", height_unit="m")
    crop = make_crop(None, (2_000_050, 500_025, 305, 12))
    with gather_points([str(west), str(east)], choose=crop.take) as joined:
        assert len(read_points(joined)) == sum(map(len, crop.take(open_points(heap)).chunks(1000)))
    far = make_crop((0, 0, 0, 1, 1, 1))
    with (
        pytest.raises(InputError, match=r"west.ply and 1 more: no points in the box") as found,
        gather_points([str(west), str(east)], choose=far.take),
    ):
        pass
    assert "lie from 2000000" in found.value.advice
    assert "to 2000099" in found.value.advice or "to 2000100" in found.value.advice


@pytest.fixture
def town(tmp_path: Path) -> Path:
    """Points of the classes 1, 2 and 7."""
    random = np.random.default_rng(2)
    classes = np.repeat(np.array([1, 2, 7], np.uint8), [40, 30, 20])
    path = tmp_path / "town.las"
    cloud = PointCloud(random.random((90, 3)), attributes={"classification": classes})
    write_points(path, cloud)
    return path


@pytest.mark.parametrize(
    ("classes", "not_classes", "points", "noise"),
    [
        (None, None, 70, 20),
        ([2], None, 30, 20),
        ([2, 7], None, 50, 0),
        (None, [1], 30, 20),
        (None, [7], 70, 20),
    ],
)
@pytest.mark.parametrize("rows", [1, 7, 1000])
def test_points_are_chosen_by_class_and_noise_is_counted(
    town: Path,
    classes: list[int] | None,
    not_classes: list[int] | None,
    points: int,
    noise: int,
    rows: int,
) -> None:
    crop = make_crop(classes=classes, not_classes=not_classes)
    source = crop.take(open_points(town, keeps_noise=crop.keeps_noise))
    for _ in range(2):
        assert sum(map(len, source.chunks(rows))) == points
        assert source.findings.dropped.get("noise", 0) == noise


def test_noise_of_several_files_is_there_where_it_is_asked_for(town: Path, tmp_path: Path) -> None:
    other, both = tmp_path / "other.las", tmp_path / "both.ply"
    other.write_bytes(town.read_bytes())
    for classes, points in (("7", 40), ("2", 60)):
        words = ["convert", str(town), str(other), "-o", str(both), "--classes", classes]
        assert CliRunner().invoke(hpcapp, words).exit_code == 0
        assert len(read_points(both)) == points


def test_a_column_of_any_format_tells_classes(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = "\n".join(f"{i},{i * i % 7},{i % 3},{i % 2}" for i in range(20))
    path.write_text(f"x,y,z,class\n{rows}\n")
    assert sum(map(len, make_crop(classes=[1]).take(open_points(path)).chunks(100))) == 10


def test_a_file_without_such_classes_is_one_line(heap: Path, town: Path) -> None:
    with pytest.raises(InputError, match="the points have no classes"):
        list(make_crop(classes=[2]).take(open_points(heap)).chunks(1000))
    with pytest.raises(InputError, match="no points are left by their classes") as found:
        list(make_crop(classes=[6, 9]).take(open_points(town)).chunks(1000))
    assert found.value.advice == "the file has 1, 2"


@pytest.mark.parametrize(
    ("classes", "not_classes", "said"),
    [
        ("2,x", None, "no whole numbers"),
        ("2.5", None, "no whole numbers"),
        ("-1", None, "has -1"),
        (None, "256", "has 256"),
        ("2", "3", "exclude each other"),
    ],
)
def test_what_is_no_class_is_refused(
    classes: str | None, not_classes: str | None, said: str
) -> None:
    with pytest.raises(UsageError, match=said):
        parse_crop(classes=classes, not_classes=not_classes)
