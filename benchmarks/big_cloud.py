"""Write a scan of a closed surface that may be larger than memory: big_cloud.py FILE POINTS.

``big_cloud.py FILE --check`` says how far the vertices of a mesh of it are from the surface.

The surface is a sphere with bumps, r(u) = 1 + 0.08 sin 7x sin 7y sin 7z for a direction u, so that
truth is a formula: `radius` and `normal`. The file is binary PLY, float32, with normals; the same
arguments give the same bytes. With --sweep the points come in bands from pole to pole, as from a
scanner; without, in no order at all, which is the hardest to arrange. With --uneven RATIO they are
so many times denser at one pole than at the other, falling with the square of the angle.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io import open_points

HEIGHT, WAVES = 0.08, 7.0
ROWS_AT_ONCE = 1 << 18
NAMES = ("x", "y", "z", "nx", "ny", "nz")


def radius(directions: FloatArray) -> FloatArray:
    """Return how far the surface is from the middle, in some directions (n, 3) of length 1."""
    values: FloatArray = 1.0 + HEIGHT * np.prod(np.sin(WAVES * directions), axis=1)
    return values


def normal(directions: FloatArray) -> FloatArray:
    """Return the outward normals of the surface in some directions, of length 1."""
    sines, cosines = np.sin(WAVES * directions), np.cos(WAVES * directions)
    others = np.stack([sines[:, (i + 1) % 3] * sines[:, (i + 2) % 3] for i in range(3)], axis=1)
    slope = HEIGHT * WAVES * cosines * others
    along = (slope * directions).sum(axis=1)[:, None]
    # The gradient of |p| - r(p / |p|); only what of the slope is across a direction counts.
    gradient = directions - (slope - along * directions) / radius(directions)[:, None]
    values: FloatArray = gradient / np.sqrt((gradient * gradient).sum(axis=1))[:, None]
    return values


def fall_off(shares: FloatArray, ratio: float) -> FloatArray:
    """Return the heights, 1 to -1, above which so large shares of an uneven cloud lie."""
    angles = np.linspace(0.0, np.pi, 1 << 16)
    density = 1.0 / (1.0 + (ratio - 1.0) * (angles / np.pi) ** 2)
    summed = np.cumsum(density * np.sin(angles))
    heights: FloatArray = np.cos(np.interp(shares, summed / summed[-1], angles))
    return heights


def make_rows(points: int, sweep: bool, ratio: float = 1.0) -> Iterator[np.ndarray]:
    """Yield the points and their normals, float32, shape (n, 6), some at a time."""
    for start in range(0, points, ROWS_AT_ONCE):
        rows = min(ROWS_AT_ONCE, points - start)
        random = np.random.default_rng((points, start))
        z, angle = random.random((2, rows))
        if sweep:
            z = (start + rows * z) / points
        # Equal bands of height have equal areas of the sphere.
        z = 2.0 * z - 1.0 if ratio == 1.0 else fall_off(z, ratio)
        across = np.sqrt(1.0 - z * z)
        angle *= 2.0 * np.pi
        directions = np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)
        positions = directions * radius(directions)[:, None]
        yield np.concatenate([positions, normal(directions)], axis=1).astype("<f4")


def write_cloud(path: Path, points: int, sweep: bool = False, ratio: float = 1.0) -> None:
    """Write a cloud of so many points."""
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {points}"]
    lines += [f"property float {name}" for name in NAMES]
    with path.open("wb") as file:
        file.write("\n".join([*lines, "end_header", ""]).encode())
        for rows in make_rows(points, sweep, ratio):
            file.write(rows.data)


def measure_distances(path: Path) -> tuple[int, float, float]:
    """Return the number of vertices of a mesh, and how far they are from the surface.

    Along the radius, which is about 1: the root of the mean square, and the largest distance.
    """
    count, total, largest = 0, 0.0, 0.0
    for cloud in open_points(path).chunks(ROWS_AT_ONCE):
        lengths = np.sqrt((cloud.positions * cloud.positions).sum(axis=1))
        off = np.abs(lengths - radius(cloud.positions / lengths[:, None]))
        count, total = count + len(off), total + float((off * off).sum())
        largest = max(largest, float(off.max()))
    return count, (total / count) ** 0.5, largest


def main() -> None:
    """Write a cloud, or judge a mesh."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("points", type=int, nargs="?")
    parser.add_argument("--sweep", action="store_true")
    parser.add_argument("--uneven", type=float, default=1.0, metavar="RATIO")
    parser.add_argument("--check", action="store_true")
    asked = parser.parse_args()
    if asked.check:
        vertices, rms, largest = measure_distances(asked.file)
        print(f"{vertices} vertices, off by {rms:.3g} (rms), {largest:.3g} at most")
        return
    if asked.points is None:
        parser.error("how many points?")
    began = time.perf_counter()
    write_cloud(asked.file, asked.points, asked.sweep, asked.uneven)
    took = time.perf_counter() - began
    print(f"{asked.points} points, {took:.1f} s, {1e6 * took / asked.points:.2f} us a point")


if __name__ == "__main__":
    main()
