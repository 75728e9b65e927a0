#!/usr/bin/env python3
"""Show how often volumes and heights hold the truth within what is said of them.

    benchmarks/volumes.py [--seed 0] [--pairs 200] [--grounds 200] [--piles 30] [--heaps 200]
                          [-o FILE]

Random pairs of epochs of a terrain (sites of 10 to 120 m, 700 to 20,000 points, noise to half a
spacing; heaps, pits, layers, tilts, shifts, holes, ragged edges, steep walls, uneven density),
random terrains for heights, closed piles that are reconstructed and compared, and heaps on rough or
level ground whose polygons are drawn by hand; those of less than a dozen cells are refused. The
truth is summed from the formulas of the surfaces. `within` is the share of the truths within what
is said, of heights the mean share of a terrain; `said by met` the median of what is said by the
median error of what is not told exactly.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from tables import parser_of, write_table

import hpcapp
from hpcapp.applications.compare.volume.heap import measure_heaps
from hpcapp.applications.compare.volume.measure import Change, SolidChange
from hpcapp.applications.heights.grid import grid_heights
from hpcapp.applications.surface.stitching.topology import signed_volume, surface_area
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray, PointCloud
from hpcapp.io.outlines import Drawn
from hpcapp.io.points.mesh_samples import sample_faces
from hpcapp.lab.simulate.raw.scan import RawSettings, scan_scene
from hpcapp.terrain.epoch import Epoch

Surface = Callable[[FloatArray, FloatArray], FloatArray]
FINE = 1000  # places along a side that the truth is summed over
KINDS = ("features", "features", "features", "layer", "most", "all", "thickness", "none")


@dataclass(frozen=True)
class Pair:
    """Two epochs of one site, and what changed."""

    name: str
    new: FloatArray
    old: FloatArray
    cut: float
    fill: float


@dataclass(frozen=True)
class Row:
    """One volume, or the heights of one terrain: their error, and what was said of it."""

    name: str
    part: str
    off: float
    said: float
    from_shift: float = 0.0
    is_told: bool = True
    truth: float = 0.0
    told: float = 0.0


def make_ground(rng: np.random.Generator, size: float, spacing: float) -> Surface:
    """Return hills, fine relief, a tilt and, of one in three, a steep wall."""
    waves = []
    for wavelength, steep in (
        (size * rng.uniform(0.3, 1.0), rng.uniform(0.0, 0.3)),
        (spacing * rng.uniform(6.0, 20.0), rng.uniform(0.0, 0.25)),
        (spacing * rng.uniform(2.5, 6.0), rng.choice([0.0, rng.uniform(0.0, 0.15)])),
    ):
        for _ in range(3):
            turn, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
            k = 2.0 * np.pi / wavelength * np.array([np.cos(turn), np.sin(turn)])
            waves.append((k, phase, steep * wavelength / (2.0 * np.pi) / 3.0**0.5))
    tilt = rng.normal(0.0, 0.1, 2)
    wall = size * rng.uniform(0.3, 0.7) if rng.random() < 1.0 / 3.0 else None
    rise, width = rng.uniform(0.5, 3.0) * size / 40.0, spacing * rng.uniform(0.1, 3.0)

    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        z = tilt[0] * x + tilt[1] * y
        for k, phase, amplitude in waves:
            z = z + amplitude * np.sin(k[0] * x + k[1] * y + phase)
        if wall is not None:
            z = z + rise * np.clip((x + 0.2 * y - wall) / width, 0.0, 1.0)
        return np.asarray(z)

    return height


def make_feature(rng: np.random.Generator, size: float, spacing: float) -> Surface:
    """Return a cone, a bell, a mound with a flat top, or a bank, above zero."""
    radius = max(rng.uniform(0.06, 0.2) * size, 2.5 * spacing)
    high = radius * rng.uniform(0.05, 0.7)
    cx, cy = rng.uniform(0.15, 0.85, 2) * size
    kind = rng.integers(4)
    turn = rng.uniform(0.0, np.pi)

    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        u = (x - cx) * np.cos(turn) + (y - cy) * np.sin(turn)
        v = (y - cy) * np.cos(turn) - (x - cx) * np.sin(turn)
        r = np.hypot(u, v) / radius
        if kind == 0:
            return np.asarray(high * np.clip(1.0 - r, 0.0, None))
        if kind == 1:
            return np.asarray(high * np.exp(-4.0 * r**2))
        if kind == 2:
            return np.asarray(high * np.clip(4.0 * (1.0 - r), 0.0, 1.0))
        box = np.maximum(np.abs(u) / radius, 2.0 * np.abs(v) / radius)
        return np.asarray(high * np.clip(3.0 * (1.0 - box), 0.0, 1.0))

    return height


def make_change(rng: np.random.Generator, kind: str, size: float, spacing: float) -> Surface:
    """Return the new ground less the old one."""
    heaps = [make_feature(rng, size, spacing) for _ in range(rng.integers(0, 3))]
    pits = [make_feature(rng, size, spacing) for _ in range(rng.integers(0, 3))]
    if kind == "features" and not heaps + pits:
        heaps = [make_feature(rng, size, spacing)]
    if kind == "none":
        heaps, pits = [], []
    thick = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 1.5) * max(spacing, 0.01 * size)
    share = {"layer": rng.uniform(0.2, 0.5), "most": rng.uniform(0.5, 0.9)}.get(kind, 1.0)
    wave = 2.0 * np.pi / size * rng.uniform(0.5, 2.0)

    def change(x: FloatArray, y: FloatArray) -> FloatArray:
        d = np.zeros_like(x)
        for heap in heaps:
            d = d + heap(x, y)
        for pit in pits:
            d = d - pit(x, y)
        if kind in ("layer", "most", "all"):
            d = d + np.where(x < share * size, thick, 0.0)
        if kind == "thickness":
            d = d + thick * (1.2 + np.sin(wave * x) * np.cos(wave * y))
        return np.asarray(d)

    return change


def scan(
    rng: np.random.Generator, ground: Surface, size: float, count: int, noise: float
) -> FloatArray:
    """Return points of a ground: at random, in rows, or denser towards one corner."""
    kind = rng.integers(3)
    if kind == 0:
        x, y = rng.uniform(0.0, size, (2, count))
    elif kind == 1:
        along = max(int(np.sqrt(count * rng.uniform(1.0, 2.5))), 2)
        rows = count // along
        place = np.stack(np.meshgrid(np.arange(along) / along, np.arange(rows) / rows), -1)
        jitter = rng.uniform(0.0, 1.0, place.shape) / (along, rows)
        x, y = (size * (place + jitter)).reshape(-1, 2).T
    else:
        power = rng.uniform(1.0, 1.6)
        x, y = size * rng.uniform(0.0, 1.0, (2, count)) ** power
    return np.column_stack([x, y, ground(x, y) + rng.normal(0.0, noise, len(x))])


def make_pair(seed: int) -> Pair:
    """Return a random pair of epochs."""
    rng = np.random.default_rng((20261129, seed))
    kind = KINDS[seed % len(KINDS)]
    size = float(10.0 ** rng.uniform(1.0, 2.1))
    counts = np.exp(rng.uniform(np.log(700), np.log(20_000), 2))
    if rng.random() < 0.5:
        counts[1] = counts[0]
    spacings = size / np.sqrt(counts)
    worst = float(spacings.max())
    ground = make_ground(rng, size, worst)
    change = make_change(rng, kind, size, worst)
    noises = spacings * rng.uniform(0.0, 0.5, 2) * rng.choice([0.1, 1.0])
    new = scan(rng, lambda x, y: ground(x, y) + change(x, y), size, int(counts[0]), noises[0])
    old = scan(rng, ground, size, int(counts[1]), noises[1])
    keep_truth: BoolArray = np.ones((FINE, FINE), dtype=bool)
    axis = size * (np.arange(FINE) + 0.5) / FINE
    x, y = np.meshgrid(axis, axis)
    if rng.random() < 0.3:  # a hole in one of them, where nothing can be told
        cx, cy = rng.uniform(0.2, 0.8, 2) * size
        radius = max(0.1 * size, 5.0 * worst)
        keep_truth = np.hypot(x - cx, y - cy) >= radius
        hole = np.hypot(new[:, 0] - cx, new[:, 1] - cy) < radius
        new = new[~hole]
    if rng.random() < 0.3:  # a ragged edge of the other one

        def edge(y: FloatArray) -> FloatArray:
            return np.asarray(size * (0.85 + 0.08 * np.sin(9.0 * y / size)))

        old = old[old[:, 0] < edge(old[:, 1])]
        keep_truth = keep_truth & (x < edge(y))
    d = np.where(keep_truth, change(x, y), 0.0)
    area = (size / FINE) ** 2
    if rng.random() < 0.3:  # registration: no change
        new = new + rng.normal(0.0, 0.2, 3) * worst * (1.0, 1.0, 0.5)
    return Pair(f"{kind} {size:.0f} m {counts[0]:.0f} {counts[1]:.0f}", new, old,
                float(-area * d[d < 0.0].sum()), float(area * d[d > 0.0].sum()))  # fmt: skip


def measure_pair(pair: Pair) -> Iterator[Row]:
    """Yield what is said of a pair: cut, fill and net beside their truth."""
    change = hpcapp.compare_epochs(pair.new, pair.old)
    assert isinstance(change, Change)
    truths = {"cut": pair.cut, "fill": pair.fill, "net": pair.fill - pair.cut}
    for part, truth in truths.items():
        told = getattr(change, part)
        yield Row(pair.name, part, abs(told.volume - truth), told.uncertainty, told.from_shift,
                  told.is_significant, truth, told.volume)  # fmt: skip


def measure_ground(seed: int) -> Row:
    """Return the error of 95 % of the heights of a random terrain, and what is said of it."""
    rng = np.random.default_rng((20261130, seed))
    size, count = float(10.0 ** rng.uniform(1.0, 2.1)), int(np.exp(rng.uniform(6.5, 9.9)))
    spacing = size / np.sqrt(count)
    ground = make_ground(rng, size, spacing)
    noise = spacing * rng.uniform(0.0, 0.5) * rng.choice([0.1, 1.0])
    points = scan(rng, ground, size, count, noise)
    step = None if rng.random() < 0.5 else spacing * float(rng.uniform(1.0, 12.0))
    grid = grid_heights(Epoch("ground", PointCloud(points)), step)
    cells = np.indices(grid.values.shape) + 0.5
    truth = ground(grid.west + grid.step * cells[1], grid.north - grid.step * cells[0])
    off = np.abs(grid.values - truth)[np.isfinite(grid.values)]
    share = float((off <= grid.uncertainty).mean())
    return Row(
        f"{size:.0f} m {count}", "heights", float(np.median(off)), grid.uncertainty, told=share
    )


def draw_toe(rng: np.random.Generator, centre: FloatArray, toe: FloatArray) -> Any:
    """Return a polygon drawn by hand round a toe, (n, 2): corners and the whole of it are off."""
    radius = float(np.linalg.norm(toe - centre, axis=1).mean())
    count = rng.integers(10, 31)
    share = (np.arange(count) + rng.uniform(0.0, 1.0, count)) / count
    corners = toe[(share * len(toe)).astype(int)]
    wider = 1.0 + rng.uniform(-0.05, 0.2)
    places = centre + wider * (corners - centre) + rng.normal(0.0, 0.03, corners.shape) * radius
    return shapely.Polygon(places + rng.uniform(-0.15, 0.15, 2) * radius).buffer(0.0)


def make_heap(seed: int) -> tuple[str, FloatArray, Any, float, float]:
    """Return what a heap stands on, points of it, its polygon, and its volume, of all and within.

    One in four stands on a level floor; the polygon is drawn by hand, up to a fifth of its radius
    off, and one in four heaps hides some of itself.
    """
    rng = np.random.default_rng((20261201, seed))
    size = float(10.0 ** rng.uniform(1.0, 2.1))
    radius = size * rng.uniform(0.15, 0.25)
    high = radius * rng.uniform(0.15, 0.9)
    spacing = 2.0 * radius / rng.uniform(12.0, 90.0)
    kind, turn, narrow = rng.integers(4), rng.uniform(0.0, np.pi), rng.uniform(0.4, 1.0)
    centre = size * rng.uniform(0.45, 0.55, 2)
    is_level = seed % 4 == 3
    ground = make_ground(rng, size, spacing)

    def heap(x: FloatArray, y: FloatArray) -> FloatArray:
        u = ((x - centre[0]) * np.cos(turn) + (y - centre[1]) * np.sin(turn)) / radius
        v = ((y - centre[1]) * np.cos(turn) - (x - centre[0]) * np.sin(turn)) / radius / narrow
        r = np.hypot(u, v)
        if kind == 0:
            return np.asarray(high * np.clip(1.0 - r, 0.0, None))
        if kind == 1:
            return np.asarray(high * np.clip(1.0 - r**2, 0.0, None))
        if kind == 2:
            return np.asarray(high * np.clip(3.0 * (1.0 - r), 0.0, 1.0))
        return np.asarray(high * np.clip(2.0 * (1.0 - np.maximum(np.abs(u), np.abs(v))), 0.0, 1.0))

    t = 2.0 * np.pi * np.arange(96) / 96.0
    ring = np.stack([np.cos(t), np.sin(t)], axis=1)
    if kind == 3:
        ring /= np.abs(ring).max(axis=1, keepdims=True)
    ring *= radius * np.array([1.0, narrow])
    toe = centre + ring @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])

    def floor(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.zeros_like(x) if is_level else ground(x, y)

    noise = spacing * rng.uniform(0.0, 0.5) * rng.choice([0.1, 1.0])
    points = scan(
        rng, lambda x, y: floor(x, y) + heap(x, y), size, int((size / spacing) ** 2), noise
    )
    if rng.random() < 0.25:
        place = centre + rng.uniform(-0.5, 0.5, 2) * radius
        away = np.linalg.norm(points[:, :2] - place, axis=1)
        points = points[away > rng.uniform(0.1, 0.25) * radius]
    axis = size * (np.arange(FINE) + 0.5) / FINE
    x, y = np.meshgrid(axis, axis)
    heights = heap(x, y) * (size / FINE) ** 2
    polygon = draw_toe(rng, centre, toe)
    inside = float(heights[shapely.contains_xy(polygon, x, y)].sum())
    name = f"{'level' if is_level else 'ground'} {kind} {size:.0f} m {len(points)}"
    return name, points, polygon, float(heights.sum()), inside


def measure_heap(seed: int) -> Iterator[Row]:
    """Yield what is said of a heap above each kind of base."""
    name, points, polygon, whole, inside = make_heap(seed)
    for above in ("rim", "plane", 0.0) if name.startswith("level") else ("rim", "plane"):
        ground = Epoch("heap", PointCloud(points))
        try:
            told = measure_heaps(ground, [Drawn("", polygon)], above)[0]
        except hpcapp.InputError:
            return
        truth = inside if above == 0.0 else whole
        part = f"heap above {'Z' if above == 0.0 else above}"
        yield Row(name, part, abs(told.volume - truth), told.uncertainty, told.from_polygon,
                  truth=truth, told=told.volume)  # fmt: skip


def make_pile(rng: np.random.Generator) -> Mesh:
    """Return a closed pile: a cone, a frustum, a dome on its base, an egg, or a ridge."""
    radius = 10.0 ** rng.uniform(0.3, 1.3)
    high = radius * rng.uniform(0.3, 1.2)
    t = np.linspace(0.0, 1.0, 65)
    kind = rng.integers(5)
    if kind in (0, 1, 4):
        top = 0.0 if kind == 0 else rng.uniform(0.2, 0.7)
        profile = np.array([[0.0, 0.0], [1.0, 0.0], [top, 1.0], [0.0, 1.0]])[: 4 - (kind == 0)]
    elif kind == 2:
        arc = np.stack([np.cos(0.5 * np.pi * t), np.sin(0.5 * np.pi * t)], axis=1)
        profile = np.concatenate([[[0.0, 0.0]], arc])
    else:
        profile = np.stack([np.sin(np.pi * t), -np.cos(np.pi * t)], axis=1)
    turn = 2.0 * np.pi * np.arange(96) / 96.0
    rings = profile[:, None, :1] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    places = np.concatenate(
        [rings, np.broadcast_to(profile[:, None, 1:], (*rings.shape[:2], 1))], axis=2
    )
    number = np.arange(places[..., 0].size).reshape(places.shape[:2])
    a, b = number[:-1], number[1:]
    c, d = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    faces = np.concatenate([np.stack(f, -1).reshape(-1, 3) for f in ((a, c, b), (c, d, b))])
    narrow = rng.uniform(0.3, 0.6) if kind == 4 else rng.uniform(0.7, 1.0)
    return Mesh(places.reshape(-1, 3) * (radius, radius * narrow, high), faces)


def measure_pile(seed: int) -> Row:
    """Return the error of the volume of a pile that was scanned with normals and meshed."""
    rng = np.random.default_rng((5, seed))
    pile = make_pile(rng)
    area, count = surface_area(pile), int(np.exp(rng.uniform(np.log(2_000), np.log(40_000))))
    cloud = sample_faces(pile, count)
    assert cloud.normals is not None
    noise = float(np.sqrt(area / count)) * rng.uniform(0.0, 0.5) * rng.choice([0.1, 1.0])
    points = cloud.positions + rng.normal(0.0, noise, (count, 1)) * cloud.normals
    mesh = hpcapp.reconstruct(points, cloud.normals, close="yes")
    change = hpcapp.compare_epochs(mesh, mesh)
    assert isinstance(change, SolidChange)
    truth = abs(signed_volume(pile))
    return Row(f"{count} points", "pile", abs(change.new.volume - truth), change.new.uncertainty,
               truth=truth, told=change.new.volume)  # fmt: skip


def measure_layers() -> Iterator[tuple[str, float]]:
    """Yield the share of the ground of each scene that has several heights."""
    for scene in ("terrain", "yard", "heap", "forest", "town"):
        settings = RawSettings(points=20_000, noise=0.03, seed=0)
        points = scan_scene(scene, "airborne", settings).cloud.positions
        change = hpcapp.compare_epochs(points[::2], points[1::2])
        assert isinstance(change, Change)
        yield scene, change.layered / change.common


def summarize(rows: list[Row]) -> Iterator[list[str]]:
    """Yield of each kind: how many, the share within, what is said and met, and false alarms."""
    heaps = sorted({f"{row.part}, {row.name.split()[0]}" for row in rows if "heap" in row.part})
    kinds = {f"{row.name.split()[0]}: {row.part}" for row in rows if row.part in ("cut", "fill")}
    groups = {name: [row for row in rows if f"{row.name.split()[0]}: {row.part}" == name]
              for name in sorted(kinds)}  # fmt: skip
    groups |= {name: [row for row in rows if f"{row.part}, {row.name.split()[0]}" == name]
               for name in heaps}  # fmt: skip
    groups |= {part: [row for row in rows if row.part == part]
               for part in ("cut", "fill", "net", "pile", "heights")}  # fmt: skip
    for name, group in groups.items():
        if not group:
            continue
        if name == "heights":
            within = float(np.mean([row.told for row in group]))
        else:
            within = float(np.mean([row.off <= row.said for row in group]))
        changed = [row for row in group if row.off > 0.0] or group
        ratio = np.median([row.said for row in changed]) / np.median([row.off for row in changed])
        alarms = sum(row.is_told and row.truth == 0.0 for row in group)
        can_alarm = name.endswith(("cut", "fill", "net"))
        yield [name, str(len(group)), f"{within:.3f}", f"{ratio:.2f}",
               str(alarms) if can_alarm else "-"]  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=0, help="of the first pair")
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--grounds", type=int, default=200)
    parser.add_argument("--piles", type=int, default=30)
    parser.add_argument("--heaps", type=int, default=200)
    asked = parser.parse_args()
    logging.disable()
    rows = [row for k in range(asked.pairs) for row in measure_pair(make_pair(asked.seed + k))]
    rows += [measure_ground(asked.seed + k) for k in range(asked.grounds)]
    rows += [measure_pile(asked.seed + k) for k in range(asked.piles)]
    rows += [row for k in range(asked.heaps) for row in measure_heap(asked.seed + k)]
    print(f"{'what':24}{'number':>8}{'within':>8}{'said by met':>13}{'false alarms':>14}")
    table = list(summarize(rows))
    for name, number, within, ratio, alarms in table:
        print(f"{name:24}{number:>8}{within:>8}{ratio:>13}{alarms:>14}")
    print("share of the ground with several heights (a warning above FEW_LAYERS)")
    for scene, share in measure_layers():
        print(f"{scene:18}{share:8.4f}")
    title = "Volumes and heights: how often the truth is within what is said, and how wide that is"
    columns = ("what", "number", "within", "said by met", "false alarms")
    write_table(asked.output, title, columns, table)


if __name__ == "__main__":
    main()
