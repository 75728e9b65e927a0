#!/usr/bin/env python3
"""Show how often two scans in frames of their own are aligned rightly, and surely.

    HPCAPP_DATA=DIR benchmarks/alignment.py [--seed S] [--count N] [--only REGEX] [-o FILE]

Rooms, streets, fronts, pipe works by two tripods, an object from two of eight or of five sides,
neighbouring flights over a terrain: any turn, half of the tripods upright, noise to a spacing. A
pose is right where it places the points within half a spacing (root mean square). The other
families have no answer: a pipe, a plain, an empty square hall, a round thing, and two different
things. What traces rays lies in the folders `worlds` and `raw` of the shared scans; it needs
`trimesh` and `embreex`.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from tables import Row, parser_of, write_table
from worlds import load_tool

from hpcapp.alignment.pair import align_pair
from hpcapp.alignment.pose import difference, invert, make_pose, move
from hpcapp.alignment.viewpoint import see_scan
from hpcapp.geometry.points import FloatArray

SEED, COUNT = 51, 3
ANY, UPRIGHT = "any", "upright"
Random = np.random.Generator


@dataclass(frozen=True)
class Pair:
    """Points of two scans, each in its frame; the pose of the second in that of the first."""

    first: FloatArray
    second: FloatArray
    pose: FloatArray | None


class Maker:
    """Makes pairs of each family."""

    def __init__(self, data: Path) -> None:
        self._worlds = load_tool(data, "make_worlds")
        self._scanners, self._shapes = self._worlds.scanners, self._worlds.shapes
        self._meshes = SimpleNamespace(meshes=data / "tuning/meshes")

    def rooms(self, rng: Random) -> Pair:
        """Two stands in one to three rooms."""
        stands: Any = ()
        while len(stands) < 2:
            mesh, stands, _, _ = self._worlds.plan(rng)
        eyes = stands[rng.permutation(len(stands))[:2]]
        return self._stand(mesh, eyes, rng, self._worlds.between(rng, 0.001, 0.01))

    def streets(self, rng: Random) -> Pair:
        """Two stands 4 to 14 m apart."""
        mesh, length, wide = self._worlds.street(rng)
        along = rng.uniform(0.15, 0.5) * length + np.array([0.0, rng.uniform(4, 14)])
        eyes = [np.minimum(along, 0.95 * length), rng.uniform(3.2, wide - 3.2, 2), np.full(2, 1.7)]
        return self._stand(mesh, np.column_stack(eyes), rng, self._worlds.between(rng, 0.002, 0.01))

    def fronts(self, rng: Random) -> Pair:
        """Two stands before a facade with niches and ledges."""
        wide, tall = rng.uniform(3, 10), rng.uniform(3, 8)
        items: list[Any] = [((-wide, -6, -0.2), (wide, -5.5, tall), False)]
        items += [
            ((-wide, 0, -0.2), (wide, 1, tall), True),
            ((-wide, -5, -0.2), (wide, 0, 0), True),
        ]
        for _ in range(rng.integers(4, 14)):
            x, z = rng.uniform(-wide + 0.2, wide - 1.8), rng.uniform(0.2, tall - 1.3)
            x1, z1, is_ledge = (
                x + rng.uniform(0.4, 1.4),
                z + rng.uniform(0.4, 1.2),
                rng.random() < 0.5,
            )
            y = sorted((0, rng.uniform(0.08, 0.5) * (-1 if is_ledge else 1)))
            items.append(((x, y[0], z), (x1, y[1], z1), is_ledge))
        mesh = self._shapes.boxes(items, border=False)
        across, away = rng.uniform(-0.6 * wide, 0.6 * wide, 2), -rng.uniform(2.5, 4.8, 2)
        return self._stand(mesh, np.column_stack([across, away, np.full(2, 1.6)]), rng, 0.003)

    def objects(self, rng: Random, sides: int = 8) -> Pair:
        """Two neighbours of eight sides of one of the tuning meshes."""
        mesh = self._worlds.mesh_of(rng, self._meshes)
        axes = self._worlds.any_turn(rng)
        around = 2 * np.pi * (np.arange(2) + rng.uniform()) / sides
        above = np.radians(rng.uniform(-10, 40, 2))
        flat = np.column_stack([np.cos(around), np.sin(around)]) * np.cos(above)[:, None]
        caster = self._scanners.Caster(*mesh)
        spacing = self._worlds.between(rng, 0.004, 0.012)
        noise, scans, eyes = spacing * self._worlds.between(rng, 0.05, 1.0), [], []
        for ray in np.column_stack([flat, np.sin(above)]) @ axes:
            eye, rays = self._scanners.image(caster, ray, int(1 / spacing), rng)
            scans.append(self._scanners.measure(caster, eye, rays, rng, lambda _: noise)[0])
            eyes.append(eye)
        return self._free(scans, eyes, rng, ANY)

    def far_sides(self, rng: Random) -> Pair:
        """The same of five sides."""
        return self.objects(rng, 5)

    def terrains(self, rng: Random) -> Pair:
        """Two flights that overlap by 30 to 70 %."""
        extent = np.array([rng.uniform(60, 150), rng.uniform(40, 100)])
        height, ground = self._worlds.terrain(
            rng, extent, self._worlds.between(rng, 0.01, 0.08) * extent[0]
        )
        parts = [ground]
        for _ in range(rng.choice([0, 0, 2, 5])):
            corner = rng.uniform(0.15, 0.85, 2) * extent
            size, tall = (rng.uniform(6, 12), rng.uniform(5, 9)), rng.uniform(2.5, 7)
            parts += self._shapes.house(
                corner, size, rng.uniform(0, np.pi), float(height(*corner)), tall, 0
            )
        mesh = self._shapes.join(*parts)
        caster, count = self._scanners.Caster(*mesh), int(self._worlds.between(rng, 10e3, 40e3))
        overlap = rng.uniform(0.3, 0.7)
        width = extent[0] / (2 - overlap)
        noise = np.sqrt(width * extent[1] / count) * self._worlds.between(rng, 0.05, 0.5)
        scans, eyes = [], []
        for low in (0.0, width * (1 - overlap)):
            places = rng.uniform([low, 0], [low + width, extent[1]], (count, 2))
            above = np.column_stack([places, np.full(count, mesh[0][:, 2].max() + 200.0)])
            face, depth = caster.cast(above, np.tile([0.0, 0.0, -1.0], (count, 1)))
            above[:, 2] -= depth
            points = above[face >= 0]
            scans.append(points + rng.normal(0, noise, points.shape) * [0.5, 0.5, 1.0])
            eyes.append(np.array([low + width / 2, extent[1] / 2, 0.0]))
        return self._free(scans, eyes, rng, rng.choice([ANY, UPRIGHT]))

    def pipe(self, rng: Random) -> Pair:
        """Two stands in a straight pipe."""
        axis = np.column_stack([np.linspace(0, 40, 80), np.zeros(80), np.zeros(80)])
        mesh = self._worlds.sweep(axis, 2.0, 32, inward=True, caps=False)
        eyes = np.array([[15 + rng.uniform(0, 4), 0, 0], [20 + rng.uniform(0, 4), 0, 0]])
        return replace(self._stand(mesh, eyes, rng, 0.004, lowest=-80, reach=11), pose=None)

    def plain(self, rng: Random) -> Pair:
        """A plain, twice."""
        flat = [np.append(rng.uniform(0, 50, (20_000, 2)), np.zeros((20_000, 1)), 1) for _ in "ab"]
        scans = [points + rng.normal(0, 0.05, points.shape) for points in flat]
        return replace(self._free(scans, np.zeros((2, 3)), rng, UPRIGHT), pose=None)

    def square_hall(self, rng: Random) -> Pair:
        """Two stands in an empty hall of which four turns are alike."""
        boxes = [((-0.2, -0.2, -0.2), (8.2, 8.2, 3.2), True), ((0, 0, 0), (8, 8, 3), False)]
        eyes = np.column_stack([rng.uniform(2, 6, (2, 2)), np.full(2, 1.5)])
        mesh = self._shapes.boxes(boxes, border=False)
        return replace(self._stand(mesh, eyes, rng, 0.004), pose=None)

    def round_thing(self, rng: Random) -> Pair:
        """Two sides of a bottle."""
        profile = [(0, 0.0), (0.5, 0.0), (0.5, 1.2), (0.35, 1.6), (0, 1.7)]
        mesh = self._shapes.revolve(profile, 64)
        caster, scans = self._scanners.Caster(np.asarray(mesh[0], float), np.asarray(mesh[1])), []
        for around in (rng.uniform(), rng.uniform() + 0.8):
            ray = np.array([np.cos(around), np.sin(around), 0.3])
            eye, rays = self._scanners.image(caster, ray / np.linalg.norm(ray), 120, rng)
            scans.append(self._scanners.measure(caster, eye, rays, rng, lambda _: 0.004)[0])
        return replace(self._free(scans, np.zeros((2, 3)), rng, ANY), pose=None)

    def different(self, rng: Random) -> Pair:
        """Two things that have nothing in common."""
        families = [self.rooms, self.streets, self.fronts, self.objects, self.terrains]
        make: Callable[[Random], Pair] = families[int(rng.integers(len(families)))]
        return Pair(make(rng).first, make(rng).second, None)

    def _stand(self, mesh: Any, eyes: FloatArray, rng: Random, noise: float, **more: float) -> Pair:
        count = int(self._worlds.between(rng, 15e3, 60e3))
        scans = [
            self._scanners.tripod_scan(mesh, rng, [eye], count, noise=noise, **more)[0]
            for eye in eyes
        ]
        return self._free(scans, eyes, rng, rng.choice([ANY, UPRIGHT]))

    def _free(self, scans: Sequence[FloatArray], eyes: Any, rng: Random, turns: str) -> Pair:
        """Give each scan a frame of its own, with its eye at zero."""
        frames = []
        for eye in eyes:
            turn = self._worlds.any_turn(rng)
            if turns == UPRIGHT:
                turn = self._worlds.turned(rng.uniform(0, 2 * np.pi))
            frames.append(make_pose(turn, -turn @ eye))
        first, second = (move(frame, points) for frame, points in zip(frames, scans, strict=True))
        return Pair(first, second, frames[0] @ invert(frames[1]))


FAMILIES = (
    "rooms", "streets", "fronts", "objects", "far_sides", "terrains",
    "pipe", "plain", "square_hall", "round_thing", "different",
)  # fmt: skip


def main() -> None:
    """Align pairs of every family, and write the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--only", default=".", help="of the families, a regular expression")
    asked = parser.parse_args()
    maker, rows = Maker(Path(os.environ["HPCAPP_DATA"])), list[Row]()
    for number, family in enumerate(FAMILIES):
        if not re.search(asked.only, family):
            continue
        for index in range(asked.count):
            pair = getattr(maker, family)(np.random.default_rng([asked.seed, number, index]))
            start = time.process_time()
            samples = see_scan(pair.first), see_scan(pair.second)
            found = align_pair(*samples)
            cost = time.process_time() - start
            off: str | float = "-"
            if pair.pose is not None:
                spacing = max(sample.spacing for sample in samples)
                off = round(difference(found.pose, pair.pose, pair.second) / spacing, 3)
            told = found.verdict.worth, found.next_worth, found.slid_worth, found.verdict.through
            rows.append([family, off, *(round(value, 3) for value in told), round(cost, 1)])
            print(*rows[-1], "sure" if found.is_sure else "", flush=True)
    title = f"Pairs of scans of seed {asked.seed}: spacings off, and what tells that they are right"
    columns = ["family", "off", "worth", "next", "slid", "through", "CPU s"]
    write_table(asked.output, title, columns, rows)


if __name__ == "__main__":
    main()
