"""Scan lines against clouds whose gap between lines, and step along them, are known."""

from __future__ import annotations

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.scale.local_scale import count_depth, count_scale
from hpcapp.applications.surface.scale.scan_lines import (
    SHARE,
    GapBoxes,
    count_narrow,
    find_gaps,
    find_spare,
    keep_lines,
)
from hpcapp.geometry.lattice import cells_of, pack_places
from hpcapp.geometry.points import FloatArray, IntArray

ORIGIN, EDGE = np.full(3, -8.0), 0.0625


def find(positions: FloatArray, spacing: float, share: float = SHARE, parts: int = 1) -> GapBoxes:
    """Find the lines of a cloud that is counted in slabs of whole blocks."""
    slab = np.floor((positions[:, 0] - ORIGIN[0]) / (4.0 * EDGE)).astype(int) % parts
    slabs = [positions[slab == i] for i in range(parts)]
    depth = count_depth(EDGE, spacing)
    counted = [count_scale(some, ORIGIN, EDGE, depth) for some in slabs]
    boxes = find_gaps(ORIGIN, EDGE, depth, counted[::-1])
    return keep_lines(boxes, [count_narrow(some, boxes) for some in slabs], share)


def bend(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return points of a tilted, wavy sheet."""
    z = 0.6 * y + 0.1 * np.sin(3.0 * x) * np.cos(2.0 * y)
    return np.stack([x, 0.8 * y, z], axis=1)


def scan(gap: float, step: float, noise: float = 0.0) -> FloatArray:
    """Return lines on a sheet of 2 x 2."""
    random = np.random.default_rng(1)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 2, gap), np.arange(0, 2, step)))
    positions = bend(x, y)
    return positions + random.normal(0.0, noise, positions.shape)


def even(kind: str) -> FloatArray:
    """Return points as dense in all directions, some .02 apart."""
    random, count = np.random.default_rng(2), 10_000
    if kind == "lattice":
        return scan(0.02, 0.02)
    x, y = random.uniform(0.0, 2.0, (2, count))
    if kind == "falling":  # as before a scanner: the spacing grows with the distance, twentyfold
        distance, angle = 0.1 * 20.0 ** random.uniform(0.0, 1.0, count), np.pi * y
        x, y = distance * np.cos(angle), distance * np.sin(angle)
    positions = bend(x, y)
    if kind == "noisy":
        positions += random.normal(0.0, 0.01, positions.shape)
    if kind == "ball":
        positions = random_directions(count, random)
    if kind == "flying":  # a sheet far from another, and points between them
        far = positions[:5_000] * (1.0, 1.0, 0.01) + (0.0, 0.0, 4.0)
        between = random.uniform((0.0, 0.0, 0.0), (2.0, 2.0, 4.0), (300, 3))
        positions = np.concatenate([positions[5_000:], far, between])
    return positions


EVEN = ["lattice", "random", "falling", "noisy", "ball", "flying"]
LINES = [(0.05, 0.006), (0.05, 0.002), (0.1, 0.002), (0.1, 0.01)]


def spacing_of(line: tuple[float, float]) -> float:
    """Return the spacing that the density of lines gives."""
    return float(np.sqrt(line[0] * line[1]))


@pytest.mark.parametrize("kind", EVEN)
def test_even_points_are_no_lines(kind: str) -> None:
    assert not len(find(even(kind), 0.02).keys)


@pytest.mark.parametrize("line", LINES)
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.03])
def test_the_gap_is_found_through_noise_that_makes_lines_thick(
    line: tuple[float, float], noise: float
) -> None:
    """The noise, in gaps, is up to one and a half steps along the lines."""
    positions = scan(*line, noise * line[0])
    boxes = find(positions, spacing_of(line))
    assert np.isin(_cells(positions, boxes), boxes.keys).mean() > 0.9
    assert np.median(boxes.gaps) == pytest.approx(line[0], rel=0.25)
    assert 0.8 * line[1] < np.median(boxes.steps) < 2.2 * line[1]  # noise fills more boxes


@pytest.mark.parametrize("line", LINES)
def test_one_point_of_each_box_stays_and_no_line_is_torn(line: tuple[float, float]) -> None:
    positions = scan(*line)
    boxes = find(positions, spacing_of(line))
    kept = positions[~find_spare(positions, boxes)]
    assert len(kept) < 8.0 * 4.0 / line[0] ** 2  # of 4 square units
    for x in np.unique(positions[:, 0]):
        assert np.diff(np.sort(kept[kept[:, 0] == x, 1])).max() < line[0]


def test_a_lone_line_is_no_sparse_surface() -> None:
    wire = np.stack([np.arange(0, 2, 0.001), np.full(2000, 0.3), np.full(2000, 1.0)], axis=1)
    assert not len(find(wire, 0.02).keys)


def test_beside_lines_even_points_all_stay() -> None:
    beside = even("random") + np.array([3.0, 0.0, 0.0])
    positions = np.concatenate([scan(0.05, 0.002), beside])
    spare = find_spare(positions, find(positions, 0.015))
    assert spare[: -len(beside)].mean() > 0.8
    assert not spare[-len(beside) :].any()


def test_lines_do_not_depend_on_regions() -> None:
    positions = np.concatenate([scan(0.05, 0.002), even("random") + np.array([3.0, 0.0, 0.0])])
    one, many = find(positions, 0.015), find(positions, 0.015, parts=5)
    assert len(one.keys)
    for name in ("keys", "doublings", "gaps", "steps"):
        assert getattr(one, name).tobytes() == getattr(many, name).tobytes()


def test_the_share_that_parts_lines_from_even_points_has_a_margin() -> None:
    """Moved by a tenth it changes nothing, by half it does on either side."""
    dense = [(even(kind), 0.02) for kind in EVEN]
    lines = [(scan(*line, 0.03 * line[0]), spacing_of(line)) for line in LINES]
    for share in (0.9 * SHARE, SHARE, 1.1 * SHARE):
        assert not any(len(find(*some, share).keys) for some in dense)
        assert all(len(find(*some, share).keys) for some in lines)
    assert any(len(find(*some, 0.5 * SHARE).keys) for some in dense)
    thick = scan(0.05, 0.002, 0.0025), spacing_of((0.05, 0.002))
    assert len(find(*thick, 1.5 * SHARE).keys) < 0.5 * len(find(*thick).keys)


def _cells(positions: FloatArray, boxes: GapBoxes) -> IntArray:
    places = np.floor(cells_of(positions, boxes.origin, boxes.edge * 2.0**boxes.depth))
    return pack_places(places.astype(np.int64))
