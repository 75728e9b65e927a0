"""Wires are no surface; scan lines, rims and thin parts are some."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.cleaning.drive import drop_strays, thin_lines
from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.geometry.points import BoolArray, FloatArray, PointCloud

Random = np.random.Generator


@pytest.fixture
def random() -> Random:
    return np.random.default_rng(4)


def find_dropped(positions: FloatArray) -> BoolArray:
    """Tell which points are dropped along lone lines, and as nothing else."""
    cloud = PointCloud(positions, attributes={"row": np.arange(len(positions))})
    thinned, _, scale = thin_lines(MemoryPass(arrange_cloud(cloud)))
    kept, cleaned, _ = drop_strays(thinned, scale)
    dropped = np.zeros(len(positions), np.bool_)
    dropped[thinned.cloud.points.attributes["row"]] = True
    dropped[kept.cloud.points.attributes["row"]] = False
    assert dropped.sum() == cleaned.outliers + cleaned.strays + cleaned.lone_lines
    assert cleaned.lone_lines or not dropped.any()
    return dropped


def ground(random: Random, side: float = 60.0) -> FloatArray:
    """Rolling ground with a point on each unit square, in the mean."""
    x, y = random.uniform(0.0, side, (2, int(side * side)))
    return np.stack([x, y, np.sin(0.1 * x) + np.cos(0.1 * y)], axis=1)


def wire(random: Random, height: float, y: float = 30.0, step: float = 0.25) -> FloatArray:
    """A sagging line of points over it, not evenly spaced."""
    x = np.sort(random.uniform(2.0, 58.0, int(56.0 / step)))
    line = np.stack([x, np.full(len(x), y), height + 0.003 * (x - 30.0) ** 2], axis=1)
    return line + random.normal(0.0, 0.02, line.shape)


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("apart", [4.0, 8.0])
def test_wires_over_ground_are_dropped(random: Random, count: int, apart: float) -> None:
    land = ground(random)
    wires = [wire(random, 25.0, 20.0 + i * apart) for i in range(count)]
    dropped = find_dropped(np.concatenate([land, *wires]))
    assert dropped[len(land) :].mean() > 0.98
    assert not dropped[: len(land)].any()


@pytest.mark.parametrize(("height", "are_dropped"), [(12.0, True), (8.0, False)])
def test_a_line_near_a_surface_may_be_part_of_it(
    random: Random, height: float, are_dropped: bool
) -> None:
    """Its neighbours are one unit away: ten times as far there must be nothing else."""
    flat = ground(random) * [1.0, 1.0, 0.0]
    x = np.arange(2.0, 58.0, 0.25)
    line = np.stack([x, np.full(len(x), 30.0), np.full(len(x), height)], axis=1)
    dropped = find_dropped(np.concatenate([flat, line]))
    assert (dropped[len(flat) :].mean() > 0.9) == are_dropped
    assert not dropped[: len(flat)].any()


@pytest.mark.parametrize(("thickness", "are_dropped"), [(0.105, True), (0.145, False)])
def test_a_line_is_thin(random: Random, thickness: float, are_dropped: bool) -> None:
    """Variance 0.75 along three spacings of it, and across them 0.015 or 0.028 of that."""
    x = np.arange(2.0, 58.0, 0.25)
    y = 30.0 + thickness * (-1.0) ** np.arange(len(x))
    line = np.stack([x, y, np.full(len(x), 25.0)], axis=1)
    dropped = find_dropped(np.concatenate([ground(random), line]))
    assert (dropped[-len(x) :].mean() > 0.9) == are_dropped


@pytest.mark.parametrize(("count", "are_dropped"), [(1, True), (3, False)])
def test_what_most_points_lie_on_was_scanned(random: Random, count: int, are_dropped: bool) -> None:
    """A wire over a little ground has 36 % of all points; three of them have 63 %."""
    land = ground(random, 20.0)
    wires = [wire(random, 25.0, 2.0 + 8.0 * i) for i in range(count)]
    dropped = find_dropped(np.concatenate([land, *wires]))
    assert (dropped[len(land) :].mean() > 0.98) == are_dropped
    assert not dropped[: len(land)].any()


@pytest.mark.parametrize("ratio", [3.0, 8.0, 15.0])
def test_scan_lines_and_their_rims_stay(random: Random, ratio: float) -> None:
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 60), np.arange(0, 60, 1.0 / ratio)))
    sheet = np.stack([x, y, np.sin(0.1 * x)], axis=1) + random.normal(0.0, 0.01, (len(x), 3))
    assert not find_dropped(sheet).any()


def test_thin_legs_and_a_stack_of_rings_stay(random: Random) -> None:
    """Legs are thinner than the spacing; a cone in rings gets as thin as these are apart."""
    top = ground(random, 30.0) * [1.0, 1.0, 0.0]
    legs = [
        np.stack([np.full(30, x), np.full(30, y), -0.25 * np.arange(30)], axis=1)
        for x in (3.0, 27.0)
        for y in (3.0, 27.0)
    ]
    assert not find_dropped(np.concatenate([top, *legs])).any()
    rings = []
    for height in np.arange(0.0, 30.0):
        radius = 0.3 * (31.0 - height)
        angle = np.arange(0.0, 2.0 * np.pi, 0.1 / radius)
        ring = radius * np.cos(angle), radius * np.sin(angle), np.full(len(angle), height)
        rings.append(np.stack(ring, axis=1))
    assert not find_dropped(np.concatenate(rings)).any()
