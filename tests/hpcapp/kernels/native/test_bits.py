"""A row's bits depend on no other row of its batch, and on no number of threads."""

from __future__ import annotations

import itertools
from dataclasses import astuple
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from hpcapp.kernels import portable
from hpcapp.kernels.types.field import Field
from hpcapp.kernels.types.grid import OPEN, OWN, BrickKinds, Grid

THREADS = (2, 3, 16)
BOUNDS = (0.3, 1000.0)  # of the priors' weights


def same(first: Any, second: Any) -> None:
    for one, other in zip(first, second, strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize("threads", THREADS)
def test_threads(native: ModuleType, cloud: Any, threads: int) -> None:
    points = (cloud.local, cloud.sorted_normals, cloud.offsets)
    one, several = (native.accumulate_moments(*points, threads=count) for count in (1, threads))
    same([one], [several])
    around = (cloud.touched, cloud.cells, cloud.moments)
    same([native.corner_moments(*around, 1)], [native.corner_moments(*around, threads)])
    noise = np.linspace(0.0, 0.02, len(cloud.touched), dtype=np.float32)
    lam = np.linspace(0.2, 1.0, len(noise), dtype=np.float32)
    fits = (*around, np.zeros((len(cloud.touched), 10), np.float32), noise, lam, *BOUNDS)
    fitted = native.fit_corners(*fits, 1)
    same(fitted, native.fit_corners(*fits, threads))
    pieces = (cloud.touched, cloud.cells, cloud.offsets, cloud.local, cloud.sorted_normals, 1e-4)
    same(native.fit_features(*pieces, 1), native.fit_features(*pieces, threads))
    parents = portable.parent_keys(cloud.touched)
    means = np.ones((len(parents), 10), np.float32)
    level = (cloud.touched, parents, means, means[:, :3].copy())
    same(native.inherit_level(*level, 1), native.inherit_level(*level, threads))
    samples = (cloud.positions * 8.0 + 16.0, cloud.normals, 1.5, np.array([[2, 30], [4, 29]]), 32)
    whole = native.integrate_normals(*samples, 1)
    same([whole], [native.integrate_normals(*samples, threads)])


@pytest.mark.parametrize("threads", THREADS)
def test_threads_of_the_extraction(
    native: ModuleType, ball: tuple[Field, Grid], threads: int
) -> None:
    function, grid = ball
    kinds = np.full(grid.bricks, OPEN, np.uint8)
    kinds[4, 3, 3] = OWN
    arguments = function, grid, BrickKinds(np.zeros(3, np.int64), kinds)
    mesh = native.grow_surface(*arguments, 1)
    assert len(mesh.faces)
    same(astuple(mesh), astuple(native.grow_surface(*arguments, threads)))


@pytest.mark.parametrize("parts", [2, 7])
def test_batches(native: ModuleType, cloud: Any, parts: int) -> None:
    whole = native.accumulate_moments(cloud.local, cloud.sorted_normals, cloud.offsets)
    cuts = np.linspace(0, len(cloud.cells), parts + 1).astype(int)
    pieces = []
    for start, stop in itertools.pairwise(cuts):
        bounds = cloud.offsets[start : stop + 1]
        rows = slice(bounds[0], bounds[-1])
        offsets = bounds - bounds[0]
        pieces.append(
            native.accumulate_moments(cloud.local[rows], cloud.sorted_normals[rows], offsets)
        )
    assert np.concatenate(pieces).tobytes() == whole.tobytes()


@pytest.mark.parametrize("parts", [2, 7])
def test_batches_of_fits(native: ModuleType, cloud: Any, parts: int) -> None:
    vertices = len(cloud.touched)
    prior = np.random.default_rng(1).normal(size=(vertices, 10)).astype(np.float32)
    noise = np.linspace(0.0, 0.02, vertices, dtype=np.float32)
    lam = np.linspace(0.2, 1.0, vertices, dtype=np.float32)
    around = (cloud.cells, cloud.moments)
    whole = native.fit_corners(cloud.touched, *around, prior, noise, lam, *BOUNDS, 1)
    cuts = np.linspace(0, vertices, parts + 1).astype(int)
    given = (cloud.touched, prior, noise, lam)
    fitted = []
    for a, b in itertools.pairwise(cuts):
        touched, *values = (some[a:b] for some in given)
        fitted.append(native.fit_corners(touched, *around, *values, *BOUNDS, 1))
    same(whole, [np.concatenate(column) for column in zip(*fitted, strict=True)])
