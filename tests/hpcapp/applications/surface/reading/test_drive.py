"""A file that is arranged on disk, part by part, gives the points of one that is read whole."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from passes import alone

from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.point_workers import PointWorkers
from hpcapp.applications.surface.reading import drive as ingest
from hpcapp.applications.surface.reading import tasks
from hpcapp.applications.surface.reading.drive import ingest_file
from hpcapp.applications.surface.reading.reach import EvenSample, drop_far
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import drop_unusable, open_points, read_points, write_points
from hpcapp.workforce import Workforce
from hpccomponent.errors import InputError


def _scan(points: int = 5_000) -> PointCloud:
    random = np.random.default_rng(points)
    positions = random.normal(size=(points, 3)) * (1.0, 0.2, 0.5)
    return PointCloud(positions, random.normal(size=(points, 3)))


def _spoil(scan: PointCloud) -> PointCloud:
    positions, normals = scan.positions.copy(), scan.normals.copy()  # type: ignore[union-attr]
    positions[7, 1] = np.nan
    positions[4_000] = np.inf
    normals[[9, 3_333]] = 0.0
    return PointCloud(positions, normals, origin=scan.origin)


def _mark(scan: PointCloud) -> PointCloud:
    positions = scan.positions.copy()
    positions[[0, 2_000]] = [[1e5, 0.0, 0.0], [-9e4, -9e4, -9e4]]
    return PointCloud(positions, scan.normals, origin=scan.origin)


def _move(scan: PointCloud) -> PointCloud:
    return PointCloud(scan.positions, scan.normals, origin=np.array([5.4e6, 3.5e5, 0.0]))


@pytest.mark.parametrize("suffix", [".ply", ".xyz"])
@pytest.mark.parametrize("rows", [64, 2_500, 10_000])
@pytest.mark.parametrize("change", [lambda scan: scan, _spoil, _mark, _move])
@pytest.mark.parametrize("far", [True, False])
def test_parts_arranged_on_disk_are_the_cloud_in_memory(
    tmp_path: Path, suffix: str, rows: int, change: object, far: bool
) -> None:
    path = tmp_path / f"a{suffix}"
    write_points(path, change(_scan()))  # type: ignore[operator]
    usable, dropped = drop_unusable(read_points(path))
    near = drop_far(usable) if far else usable
    expected = arrange_cloud(near)
    (tmp_path / "parts").mkdir()
    found = ingest_file(open_points(path), tmp_path / "parts", alone(rows), drop_far=far)
    assert found.dropped == dropped
    assert found.far == len(usable) - len(near)
    assert found.cloud.arrangement.edge == expected.arrangement.edge
    for name in ("origin", "keys", "counts", "low", "high"):
        assert getattr(found.cloud, name).tobytes() == getattr(expected, name).tobytes()
    for mine, its in zip(
        found.cloud.take_blocks(expected.keys), expected.take_blocks(expected.keys), strict=True
    ):
        assert mine.tobytes() == its.tobytes()


@pytest.mark.parametrize("workers_see", [True, False])
@pytest.mark.parametrize("at_once", [1_000, 1 << 18])
def test_workers_read_their_ranges(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers_see: bool, at_once: int
) -> None:
    """Many of them, none of which knows how many unusable points lie before its own."""
    monkeypatch.setattr(tasks, "_AT_ONCE", at_once)
    path = tmp_path / "a.ply"
    write_points(path, _spoil(_scan(60_000)))
    expected = arrange_cloud(drop_far(drop_unusable(read_points(path))[0]))
    (tmp_path / "parts").mkdir()
    with ThreadPoolExecutor(4) as executor:
        workforce = Workforce(executor, 4, 4)
        workers = PointWorkers(workforce, True, 900, workers_see)
        found = ingest_file(open_points(path), tmp_path / "parts", workers)
    assert len(found.cloud.parts) == (16 if workers_see else 10)  # each as often, as memory asks
    one, other = (cloud.take_blocks(expected.keys) for cloud in (found.cloud, expected))
    assert [column.tobytes() for column in one] == [column.tobytes() for column in other]


@pytest.mark.parametrize("at_once", [700, 1 << 18])
def test_the_sample_of_ranges_is_that_of_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_once: int
) -> None:
    """As the far points and lines that are looked for in it."""
    write_points(tmp_path / "a.ply", _spoil(_scan(90_000)))
    source = open_points(tmp_path / "a.ply")
    monkeypatch.setattr(tasks, "_AT_ONCE", at_once)
    ranges = ingest._survey_records(source, alone(1_400))
    parts = ingest._survey_parts(replace(source, records=None), alone(11_000))
    assert ranges.sample.tobytes() == parts.sample.tobytes()
    assert 10_000 < len(parts.sample) <= 20_000


def test_markers_are_found_in_a_large_sample_as_in_parts() -> None:
    positions = np.arange(300_000.0).reshape(-1, 3)
    whole, parts = EvenSample(), EvenSample()
    whole.add(positions)
    for part in np.array_split(positions, 37):
        parts.add(part)
    assert whole.positions.tobytes() == parts.positions.tobytes()
    assert 10_000 < len(whole.positions) <= 20_000
    assert set(np.diff(whole.positions[:, 0])) == {24.0}


def _line(points: int) -> FloatArray:
    return np.linspace(0, 1, points)[:, None] * (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("positions", "said"),
    [
        (np.zeros((0, 3)), "holds no points"),
        (np.full((30, 3), np.nan), "no usable points after dropping 30 with NaN"),
        (np.eye(3), "has 3 usable points"),
        (np.ones((30, 3)), "all 30 points lie in one place"),
        (_line(50_000), "all 50000 points lie on one line"),
        (np.eye(3)[np.arange(30) % 3] * 1e90, "largest coordinate is 1e[+]90"),
    ],
)
def test_clouds_without_a_surface_are_refused_as_from_memory(
    tmp_path: Path, positions: FloatArray, said: str
) -> None:
    path = tmp_path / "a.ply"
    write_points(path, PointCloud(positions, np.ones_like(positions)))
    with pytest.raises(InputError, match=said) as whole:
        drop_unusable(read_points(path), str(path))
    with pytest.raises(InputError, match=said) as parts:
        ingest_file(open_points(path), tmp_path, alone(7_000))
    assert str(parts.value) == str(whole.value)


def test_a_line_is_told_from_all_points_where_the_sample_does_not_tell(tmp_path: Path) -> None:
    positions = _line(50_000)
    positions[1] += (0.0, 0.0, 0.5)  # is not in the sample, which has every fourth
    write_points(tmp_path / "a.ply", PointCloud(positions, np.ones_like(positions)))
    assert (
        len(ingest_file(open_points(tmp_path / "a.ply"), tmp_path, alone(1 << 20)).cloud) == 50_000
    )
