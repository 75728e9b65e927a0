"""How far a mesh lies from a shape whose points and normals are exact: analytic.py [SHAPE ...].

One line for each shape and grid: the largest distance of a vertex from the shape, and the root of
the mean square, in cells of the grid. Points are drawn by chance, without noise.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import hpcapp
from hpcapp.geometry.points import FloatArray

SEMI_AXES = np.array([1.0, 0.8, 0.6])
MAJOR, MINOR = 1.0, 0.4
MARGINS = 8  # cells of the grid beside the cloud, along the longest side
Random = np.random.Generator


@dataclass(frozen=True)
class Analytic:
    """A shape: points drawn on it with their normals, and the distances of points close to it."""

    draw: Callable[[Random, int], tuple[FloatArray, FloatArray]]
    measure: Callable[[FloatArray], FloatArray]


def _draw_directions(random: Random, count: int) -> FloatArray:
    arms: FloatArray = random.normal(size=(count, 3))
    values: FloatArray = arms / np.linalg.norm(arms, axis=1, keepdims=True)
    return values


def _draw_sphere(random: Random, count: int) -> tuple[FloatArray, FloatArray]:
    arms = _draw_directions(random, count)
    return arms, arms


def _measure_sphere(points: FloatArray) -> FloatArray:
    radii: FloatArray = np.linalg.norm(points, axis=1)
    return np.abs(radii - 1.0)


def _draw_ellipsoid(random: Random, count: int) -> tuple[FloatArray, FloatArray]:
    arms = _draw_directions(random, count)
    normals = arms / SEMI_AXES
    return arms * SEMI_AXES, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _measure_ellipsoid(points: FloatArray) -> FloatArray:
    """Return the value by the gradient: right to the square of the distance."""
    values = ((points / SEMI_AXES) ** 2).sum(axis=1) - 1.0
    slopes = 2.0 * np.linalg.norm(points / SEMI_AXES**2, axis=1)
    distances: FloatArray = np.abs(values) / slopes
    return distances


def _draw_torus(random: Random, count: int) -> tuple[FloatArray, FloatArray]:
    along, around = random.uniform(0.0, 2.0 * np.pi, (2, count))
    outward = np.cos(around)
    normals = np.stack([outward * np.cos(along), outward * np.sin(along), np.sin(around)], axis=1)
    circle = np.stack([np.cos(along), np.sin(along), np.zeros(count)], axis=1)
    return MAJOR * circle + MINOR * normals, normals


def _measure_torus(points: FloatArray) -> FloatArray:
    away = np.hypot(points[:, 0], points[:, 1]) - MAJOR
    distances: FloatArray = np.abs(np.hypot(away, points[:, 2]) - MINOR)
    return distances


SHAPES = {
    "sphere": Analytic(_draw_sphere, _measure_sphere),
    "ellipsoid": Analytic(_draw_ellipsoid, _measure_ellipsoid),
    "torus": Analytic(_draw_torus, _measure_torus),
}


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("shapes", nargs="*", metavar="SHAPE", help=f"all by default: {[*SHAPES]}")
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--grids", type=int, nargs="+", default=[256, 512, 1024])
    asked = parser.parse_args()
    print("| shape | grid | largest | rms |\n|---|---|---|---|")
    for name in asked.shapes or SHAPES:
        shape = SHAPES[name]
        points, normals = shape.draw(np.random.default_rng(0), asked.points)
        for grid in asked.grids:
            mesh = hpcapp.reconstruct(points, normals, grid, executor="serial")
            step = float(np.ptp(points, axis=0).max()) / (grid - MARGINS)
            errors = shape.measure(mesh.vertices) / step
            rms = float(np.sqrt((errors**2).mean()))
            print(f"| {name} | {grid} | {errors.max():.4f} | {rms:.5f} |", flush=True)


if __name__ == "__main__":
    main()
