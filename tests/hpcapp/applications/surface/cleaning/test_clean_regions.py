"""Cleaned region by region, a cloud is the one that is cleaned in one piece, byte by byte."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import alone, in_folder

from hpcapp.applications.surface.cleaning.drive import (
    Cleaned,
    drop_strays,
    mend_normals,
    thin_lines,
)
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud, arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass, PassT
from hpcapp.applications.surface.cloud.measure import measure_cloud
from hpcapp.applications.surface.cloud.point_workers import PointWorkers
from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.resolution.estimates import choose_scale
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.lab.simulate.scanner import simulate_scan
from hpcapp.lab.simulate.settings import ScanSettings
from hpcapp.lab.simulate.shapes import SHAPES
from hpcapp.workforce import Workforce

Random = np.random.Generator


def _scan(name: str, **settings: Any) -> PointCloud:
    return simulate_scan(SHAPES[name], ScanSettings(points=30_000, normals="exact", **settings))


def _sphere(random: Random, points: int, radius: float = 1.0) -> FloatArray:
    arms = random.normal(size=(points, 3))
    values: FloatArray = radius * arms / np.linalg.norm(arms, axis=1)[:, None]
    return values


def _uneven(random: Random) -> PointCloud:
    """A sphere whose density falls by a factor of a thousand, and a fog around it."""
    positions = _sphere(random, 60_000)
    kept = random.random(len(positions)) < 10.0 ** (-1.5 - 1.5 * positions[:, 2])
    fog = random.uniform(-2.0, 2.0, (300, 3))
    return _oriented(np.concatenate([positions[kept], fog]))


def _islands(random: Random) -> PointCloud:
    """A sphere, small pieces far from it, one close by, and sparse patches between."""
    pieces = [_sphere(random, 40_000)]
    for place, points in (((2.5, 0, 0), 40), ((0, 3, 0), 25), ((0, 0, 1.06), 30), ((4, 4, 4), 9)):
        pieces.append(np.array(place) + _sphere(random, points, 0.01))
    sheet = random.uniform(-0.5, 0.5, (60, 3)) * (1.0, 1.0, 0.001) + (0.0, 0.0, 1.5)
    return _oriented(np.concatenate([*pieces, sheet]))


def _spoilt_islands(random: Random) -> PointCloud:
    """The same, with some normals that point inwards where no point is dropped."""
    cloud = _islands(random)
    assert cloud.normals is not None
    cloud.normals[np.flatnonzero(cloud.positions[:40_000, 0] > 0.9)[::40]] *= -1.0
    return cloud


def _repeated(random: Random) -> PointCloud:
    """Each point many times, which is counted once."""
    return _oriented(np.repeat(_sphere(random, 900), 40, axis=0))


def _fog(random: Random) -> PointCloud:
    """Mostly points above what is the base of the rest."""
    return _oriented(
        np.concatenate([_sphere(random, 5_000, 0.1), random.uniform(-1, 1, (4_000, 3))])
    )


def _strays(random: Random) -> PointCloud:
    """A sphere, and points and clumps a few spacings off it."""
    positions = _sphere(random, 20_000)
    rows = random.permutation(len(positions))[:300]
    positions[rows] *= 1.0 + random.normal(0.0, 0.1, (300, 1))
    positions[rows[:80]] = np.repeat(positions[rows[:10]], 8, axis=0)
    positions[rows[:80]] += random.normal(0.0, 0.01, (80, 3))
    return _oriented(positions)


def _lines(random: Random) -> PointCloud:
    """A sphere scanned along circles that lie fifteen times as far apart as their points."""
    height = np.arange(-0.975, 1.0, 0.05)
    angles = [np.arange(0.0, 2.0 * np.pi, 0.0033 / np.sqrt(1.0 - z * z)) for z in height]
    z, angle = np.repeat(height, [len(some) for some in angles]), np.concatenate(angles)
    around = np.sqrt(1.0 - z * z)
    positions = np.stack([around * np.cos(angle), around * np.sin(angle), z], axis=1)
    return _oriented(positions * (1.0 + random.normal(0.0, 0.001, (len(z), 1))))


def _wires(random: Random) -> PointCloud:
    """A sphere, and three lines of points over it."""
    lines = [np.linspace([-2.0, 0.06 * i, 1.8], [2.0, 0.1 * i, 1.8], 800) for i in range(3)]
    return _oriented(np.concatenate([_sphere(random, 20_000), *lines]))


def _oriented(positions: FloatArray) -> PointCloud:
    return PointCloud(positions, positions / np.linalg.norm(positions, axis=1)[:, None])


CLOUDS: dict[str, Callable[[Random], PointCloud]] = {
    "box outliers": lambda _: _scan("box", outliers=0.03, noise=0.001),
    "frame outliers": lambda _: _scan("frame", outliers=0.1, noise=0.002),
    "flipped": lambda _: _scan("plate", flipped=0.05),
    "spoilt": lambda _: _scan("bracket", outliers=0.02, flipped=0.1, noise=0.002),
    "clean": lambda _: _scan("torus"),
    "uneven": _uneven,
    "islands": _islands,
    "spoilt islands": _spoilt_islands,
    "repeated": _repeated,
    "fog": _fog,
    "strays": _strays,
    "lines": _lines,
    "wires": _wires,
}


SPOILT = set(CLOUDS) - {"clean", "repeated", "fog", "lines", "wires"}


def _clean(cloud_pass: PassT) -> tuple[PassT, Cleaned, LocalScale]:
    cloud_pass, thinned, scale = thin_lines(cloud_pass)
    cloud_pass, found, scale = drop_strays(cloud_pass, scale)
    cloud_pass, flipped = mend_normals(cloud_pass, scale.spacing)
    return cloud_pass, replace(thinned.plus(found), flipped=flipped), scale


def _measure(cloud: ArrangedCloud) -> tuple[object, ...]:
    scale = choose_scale(cloud.measured, 0.0, 1.0, 1.0)
    noise = scale.noise.whole, scale.noise.places.spacings.tobytes()
    return scale.cell_size, scale.tolerance, scale.finer, scale.coarser, *noise


def _assert_cleaned_alike(scan: PointCloud, folder: Path, workers: PointWorkers) -> Cleaned:
    arranged = MemoryPass(arrange_cloud(scan))
    kept, cleaned, scale = _clean(arranged)
    kept, expected = measure_cloud(kept, scale), kept.cloud.points
    there = in_folder(scan, folder, workers)
    there, told, same = _clean(there)
    assert told == cleaned
    assert same.spacings.tobytes() == scale.spacings.tobytes()
    found = measure_cloud(there, scale).cloud
    assert _measure(found) == _measure(kept.cloud)
    assert estimate_spacing(expected.positions) == kept.cloud.measured.spacing
    assert found.low.tolist() == expected.positions.min(axis=0).tolist()
    assert found.high.tolist() == expected.positions.max(axis=0).tolist()
    assert len(found) == len(expected)
    positions, normals = found.take_blocks(found.keys)
    assert positions.tobytes() == expected.positions.tobytes()
    assert expected.normals is not None
    assert normals.tobytes() == expected.normals.tobytes()
    return cleaned


@pytest.mark.slow
@pytest.mark.parametrize("name", CLOUDS)
@pytest.mark.parametrize("points", [5_000, 100_000])
def test_regions_of_any_size_are_the_whole(tmp_path: Path, name: str, points: int) -> None:
    cloud = CLOUDS[name](np.random.default_rng(5))
    cleaned = _assert_cleaned_alike(cloud, tmp_path, alone(points))
    if name in SPOILT:
        assert cleaned.outliers or cleaned.strays or cleaned.flipped
    assert (cleaned.spared > 0.7 * len(cloud)) == (name == "lines")
    assert (cleaned.lone_lines > 2_000) == (name == "wires")


@pytest.mark.parametrize("seed", range(6))
def test_any_mixture_is_cleaned_alike(tmp_path: Path, seed: int) -> None:
    """Sheets, lumps, lines and single points, of densities that differ by orders of magnitude."""
    random = np.random.default_rng(seed)
    pieces = []
    for _ in range(random.integers(2, 9)):
        points = int(10.0 ** random.uniform(0.5, 3.7))
        extent = 10.0 ** random.uniform(-2.0, 0.0, 3) * random.choice([0.0, 1.0, 1.0], 3)
        pieces.append(random.normal(size=(points, 3)) * extent + random.uniform(-1, 1, 3))
    positions = np.concatenate([*pieces, random.uniform(-3, 3, (50, 3))])
    cloud = _oriented(positions[random.permutation(len(positions))])
    _assert_cleaned_alike(cloud, tmp_path, alone(1_500))


@pytest.mark.parametrize("workers_see", [True, False])
def test_only_regions_that_change_are_written(tmp_path: Path, workers_see: bool) -> None:
    positions = _sphere(np.random.default_rng(2), 30_000)
    cloud = _oriented(positions)
    assert cloud.normals is not None
    cloud.normals[np.flatnonzero(positions[:, 0] > 0.99)[::40]] *= -1.0  # a few, in one place
    cleaned = _assert_cleaned_alike(cloud, tmp_path, alone(3_000, sees=workers_see))
    assert 0 < cleaned.flipped < 100
    (changed,) = (
        index.parent for index in tmp_path.glob("*/index") if "../" in index.read_text("latin-1")
    )
    written = list(changed.glob("points.*"))
    assert 1 <= len(written) <= 4  # of ten
    assert 0 < sum(path.stat().st_size for path in written) < 24 * 15_000


@pytest.mark.slow
@pytest.mark.parametrize("workers_see", [True, False])
@pytest.mark.parametrize("name", ["spoilt", "islands", "lines", "clean"])
def test_workers_do_not_show(tmp_path: Path, name: str, workers_see: bool) -> None:
    """Whether they see the folder, and write to it, or are sent points."""
    with ThreadPoolExecutor(3) as executor:
        workers = PointWorkers(Workforce(executor, 3, 4), workers_see, 4_000)
        _assert_cleaned_alike(CLOUDS[name](np.random.default_rng(5)), tmp_path, workers)
