"""Coordinates that have lost their digits are told from those of a raster or of voxels."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.points import FloatArray
from hpcapp.io import open_points
from hpcapp.io.points.precision import find_lost_digits

RANDOM = np.random.default_rng(7)
POINTS = 20_000
UTM = np.array([476_000.0, 5_200_000.0, 400.0])
ECEF = np.array([4_201_000.0, 168_000.0, 4_780_000.0])
SWISS = np.array([2_600_000.0, 1_200_000.0, 500.0])


def make_hills(spacing: float) -> FloatArray:
    """Return a ground whose points are so far apart."""
    plan = RANDOM.uniform(0, spacing * POINTS**0.5, (POINTS, 2))
    return np.column_stack([plan, 3 * spacing * np.sin(plan[:, 0] / spacing / 40)])


def make_ball(spacing: float) -> FloatArray:
    directions = RANDOM.normal(size=(POINTS, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    ball: FloatArray = directions * spacing * (POINTS / 4 / np.pi) ** 0.5
    return ball


def make_raster(step: float, side: int = 140) -> FloatArray:
    x, y = (step * axis.ravel() for axis in np.meshgrid(np.arange(side), np.arange(side)))
    return np.column_stack([x, y, 0.37 + 5 * step * np.sin(x / step / 20)])


def make_voxels(step: float) -> FloatArray:
    return np.unique(np.rint(make_ball(step) / step), axis=0) * step


def as_single(positions: FloatArray) -> FloatArray:
    return positions.astype(np.float32).astype(np.float64)


def as_rounded(positions: FloatArray, step: float) -> FloatArray:
    return np.multiply(np.rint(positions / step), step)


LOST: dict[str, tuple[FloatArray, str]] = {
    "a ground in UTM": (as_single(make_hills(0.1) + UTM), "0.5 in y"),
    "a coarse ground in UTM": (as_single(make_hills(1.8) + UTM), "0.5 in y"),
    "a ground in the Swiss grid": (as_single(make_hills(0.3) + SWISS), "0.25 in x, 0.12 in y"),
    "a statue in UTM": (as_single(make_ball(0.01) + UTM), "0.031 in x, 0.5 in y"),
    "a ball in ECEF": (as_single(make_ball(0.2) + ECEF), "0.5 in x, 0.5 in z"),
    "a raster of 5 cm in UTM": (as_single(make_raster(0.05) + UTM), "0.5 in y"),
    "two decimals of metres": (as_rounded(make_ball(0.004), 0.01), "steps of 0.01"),
    "no decimals": (as_rounded(make_hills(0.4) + UTM, 1.0), "steps of 1"),
}

KEPT: dict[str, Callable[[], FloatArray]] = {
    "a ground in UTM, in double": lambda: make_hills(0.1) + UTM,
    "a coarse ground in UTM": lambda: as_single(make_hills(2.2) + UTM),
    "a local ground": lambda: as_single(make_hills(0.01)),
    "a raster of half a metre in UTM": lambda: as_single(make_raster(0.5) + UTM),
    "a raster of a metre in UTM, in whole heights": lambda: np.rint(make_raster(1.0) + UTM),
    "a raster in the Swiss grid": lambda: as_single(make_raster(0.5) + SWISS),
    "voxels": lambda: as_single(make_voxels(1.0)),
    "voxels in UTM": lambda: make_voxels(0.05) + UTM,
    "a lattice": lambda: np.argwhere(np.ones((20, 20, 20))).astype(np.float64),
    "two decimals of metres": lambda: as_rounded(make_ball(0.0066), 0.01),
    "every point five times": lambda: np.repeat(make_ball(0.01), 5, axis=0),
    "one place": lambda: np.zeros((500, 3)),
    "a line": lambda: np.arange(500.0)[:, None] * (0, 1, 0),
}


@pytest.mark.parametrize("name", LOST)
def test_lost_digits_are_said_with_their_step(name: str) -> None:
    positions, said = LOST[name]
    line = find_lost_digits(positions, len(positions))
    assert line is not None
    assert said in line


@pytest.mark.parametrize("name", KEPT)
def test_what_lies_on_a_lattice_of_its_own_has_lost_nothing(name: str) -> None:
    positions = KEPT[name]()
    assert find_lost_digits(positions, len(positions)) is None


def test_a_sample_is_judged_by_all_points_of_the_file(tmp_path: Path) -> None:
    """Of which it has a thirtieth, from all over."""
    plan = RANDOM.uniform(0, 600, (2_000_000, 2))
    positions = np.column_stack([plan, 0.01 * plan[:, 0]]) + UTM
    np.save(tmp_path / "a.npy", positions.astype(np.float32))
    (line,) = open_points(tmp_path / "a.npy").findings.warnings
    assert "points are some 0.42 apart" in line
