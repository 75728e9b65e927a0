"""Points that lie on no surface are refused in words; surfaces of all kinds are not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from directions import random_directions
from passes import alone, in_folder, in_memory

from hpcapp.applications.surface.cloud.arranged import MemoryCloud, arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import CloudPass, MemoryPass
from hpcapp.applications.surface.cloud.measure import measure_spacing
from hpcapp.applications.surface.cloud.surface_check import check_surface
from hpcapp.geometry.points import FloatArray, PointCloud

Random = np.random.Generator


def find(cloud_pass: CloudPass) -> str | None:
    problem = check_surface(cloud_pass, measure_spacing(cloud_pass))
    return None if problem is None else problem.problem


def lattice(*shape: int) -> FloatArray:
    return np.stack(np.meshgrid(*map(np.arange, shape)), axis=-1).reshape(-1, 3).astype(float)


def ball(random: Random, count: int) -> FloatArray:
    points = random_directions(count, random)
    filled: FloatArray = points * random.random((count, 1)) ** (1 / 3)
    return filled


def sphere(random: Random, count: int, noise: float = 0.0) -> FloatArray:
    points = random_directions(count, random)
    rough: FloatArray = points + noise * random.normal(size=(count, 3))
    return rough


def helix(random: Random, count: int, turns: float, noise: float) -> FloatArray:
    t = random.random(count)
    angle = 2.0 * np.pi * turns * t
    wire: FloatArray = np.stack([np.cos(angle), np.sin(angle), 3.0 * t], axis=1)
    return wire + noise * random.normal(size=(count, 3))


def tube(random: Random, count: int, length: float) -> FloatArray:
    """Of radius 1."""
    angle = random.uniform(0.0, 2.0 * np.pi, count)
    return np.stack([np.cos(angle), np.sin(angle), length * random.random(count)], axis=1)


def profiles(random: Random, lines: int, points: int) -> FloatArray:
    """Return lines across the flight, dense along and far apart."""
    y, x = (
        axis.ravel()
        for axis in np.meshgrid(
            np.linspace(0.0, 1.0, lines), np.linspace(0.0, 1.0, points), indexing="ij"
        )
    )
    heights = 0.1 * np.sin(5.0 * x) * np.cos(4.0 * y)
    return np.stack([x, y, heights], axis=1) + 1e-4 * random.normal(size=(len(x), 3))


def building(random: Random, count: int) -> FloatArray:
    """Return walls and floors of 6 x 6 x 4 rooms."""
    points = random.uniform(0.0, 1.0, (count, 3)) * [6.0, 6.0, 4.0]
    axis = random.integers(0, 3, count)
    rows = np.arange(count)
    points[rows, axis] = np.round(points[rows, axis])
    return points + 2e-3 * random.normal(size=(count, 3))


def forest(random: Random, count: int) -> FloatArray:
    """Return ground of 30 x 30 m, a quarter of the points, under 40 crowns that are filled."""
    ground = np.column_stack([random.uniform(0.0, 30.0, (count // 4, 2)), np.zeros(count // 4)])
    rest = count - len(ground)
    centres = np.column_stack([random.uniform(0.0, 30.0, (40, 2)), random.uniform(12, 15, 40)])
    crowns = centres[random.integers(0, 40, rest)] + ball(random, rest) * [2.5, 2.5, 5.0]
    return np.concatenate([ground, crowns])


VOLUMES: dict[str, Callable[[Random], FloatArray]] = {
    "small cube": lambda random: random.random((600, 3)),
    "large cube": lambda random: random.random((120_000, 3)),
    "ball": lambda random: ball(random, 5_000),
    "blob": lambda random: random.normal(size=(20_000, 3)),
    "lattice": lambda _: lattice(10, 10, 10),
    "large lattice": lambda _: lattice(50, 50, 50),
    "voxels, a third of them": lambda random: lattice(50, 50, 50)[random.random(125_000) < 0.3],
    "slices": lambda _: lattice(60, 60, 30) * [1.0, 1.0, 2.0],
    "particles": lambda random: lattice(18, 18, 18) + 0.1 * random.normal(size=(18**3, 3)),
    "rod": lambda random: random.random((20_000, 3)) * [5.0, 1.0, 1.0],
}
LINES: dict[str, Callable[[Random], FloatArray]] = {
    "straight": lambda random: np.outer(random.random(300), [1.0, 2.0, 3.0]),
    "wire": lambda random: helix(random, 5_000, 0.7, 0.005),
    "large wire": lambda random: helix(random, 60_000, 0.7, 0.005),
    "ring": lambda random: tube(random, 3_000, 0.0) + 0.005 * random.normal(size=(3_000, 3)),
}
SURFACES: dict[str, Callable[[Random], FloatArray]] = {
    "sphere": lambda random: sphere(random, 5_000),
    "few points": lambda random: sphere(random, 500),
    "noise of eight spacings": lambda random: sphere(random, 20_000, 0.2 / np.sqrt(8.0)),
    "sheet": lambda random: random.random((500, 3)) * [1.0, 1.0, 0.01],
    "plate": lambda random: sphere(random, 20_000) * [1.0, 1.0, 0.02],
    "rooms": lambda random: building(random, 60_000),
    "forest": lambda random: forest(random, 20_000),
    "rod": lambda random: tube(random, 1_000, 60.0),
    "pipe": lambda random: tube(random, 100_000, 600.0),
    "road": lambda random: random.random((100_000, 3)) * [20_000.0, 10.0, 0.05],
    "profiles": lambda random: profiles(random, 40, 100),
    "few profiles": lambda random: profiles(random, 5, 2_000),
    "track": lambda random: helix(random, 5_000, 20.0, 0.002),
    "blob beside it": lambda random: np.vstack([sphere(random, 6_000), ball(random, 2_000) + 3.0]),
}


@pytest.mark.parametrize("kind", sorted(VOLUMES))
def test_what_fills_a_volume_is_refused(kind: str) -> None:
    said = find(in_memory(PointCloud(VOLUMES[kind](np.random.default_rng(1)))))
    assert said is not None
    assert said.startswith("the points fill a volume")


@pytest.mark.parametrize("kind", sorted(LINES))
def test_what_follows_a_line_is_refused(kind: str) -> None:
    said = find(in_memory(PointCloud(LINES[kind](np.random.default_rng(2)))))
    assert said is not None
    assert said.startswith("the points lie on a line")


@pytest.mark.parametrize("kind", sorted(SURFACES))
def test_surfaces_are_not(kind: str) -> None:
    positions = SURFACES[kind](np.random.default_rng(3))
    distinct = PointCloud(np.unique(positions, axis=0))
    assert find(MemoryPass(arrange_cloud(distinct))) is None


@pytest.mark.parametrize("kind", ["large cube", "voxels, a third of them"])
def test_the_words_are_the_same_out_of_core(kind: str, tmp_path: Path) -> None:
    points = PointCloud(VOLUMES[kind](np.random.default_rng(1)))
    memory = find(MemoryPass(arrange_cloud(points)))
    assert memory is not None
    assert find(in_folder(points, tmp_path, alone(20_000))) == memory
    assert find(in_memory(points)) is not None


def test_a_place_with_most_of_the_points_does_not_cost_all_memory() -> None:
    random = np.random.default_rng(5)
    positions = np.vstack([sphere(random, 200_000) * 1e-6, sphere(random, 20_000)])
    assert find(MemoryPass(MemoryCloud.as_they_are(PointCloud(positions)))) is None
