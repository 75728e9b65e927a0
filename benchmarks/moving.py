#!/usr/bin/env python3
"""Show how much goes of what moved while a scene was scanned, and of what stood still.

    HPCAPP_DATA=DIR benchmarks/moving.py [--seed S] [--count N] [--only REGEX] [-o FILE]

Rooms and streets, by three or four tripods (PTX) or by a spinning scanner on a way whose times are
known (points with times and a trajectory), with walkers, and with cars in streets: some stand for a
while, some cross. A point is of what moved where its ray met a walker or a car. Scenes and rays are
those of the folder `worlds` of the shared scans; it needs `trimesh` and `embreex`.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tables import Row, parser_of, write_table
from worlds import load_tool

from hpcapp.applications.surface.normals.sensor import find_path
from hpcapp.applications.surface.normals.viewpoint import parse_viewpoint
from hpcapp.applications.surface.reading.seen_through import are_seen_through, look_around
from hpcapp.geometry.points import BoolArray, FloatArray
from hpcapp.io import open_points, read_whole

SEED, COUNT = 72, 4
WALKER, CAR = np.array([0.5, 0.4, 1.75]), np.array([4.2, 1.8, 1.5])  # metres
NOISE, REACH = 0.004, 60.0
TURN_S, MOVE_S = 20.0, 120.0  # of a tripod: a turn, and the way to the next stand
BEAMS, TURNS_HZ, RATE_HZ = 32, 10.0, 200_000.0
Random = np.random.Generator


@dataclass(frozen=True)
class Mover:
    """A box that stands on the ground and goes straight on between two times."""

    size: FloatArray
    start: FloatArray
    speed: FloatArray
    begin: float
    end: float


@dataclass(frozen=True)
class Pulses:
    """Where rays begin, where they go, and when: (n, 3), (n, 3), (n,)."""

    eyes: FloatArray
    rays: FloatArray
    times: FloatArray


@dataclass(frozen=True)
class Scene:
    """A file of a scan, its trajectory if any, and what of it moved, in the file's order."""

    words: tuple[str, ...]
    path: Path
    has_moved: BoolArray


def meet(movers: Sequence[Mover], pulses: Pulses) -> FloatArray:
    """Return how far along each ray a mover is, (n,); infinity where none is."""
    nearest = np.full(len(pulses.times), np.inf)
    for one in movers:
        rows = np.flatnonzero((pulses.times >= one.begin) & (pulses.times < one.end))
        middle = one.start + (pulses.times[rows, None] - one.begin) * one.speed
        way = one.speed if one.speed.any() else np.array([1.0, 0.0, 0.0])
        turn: FloatArray = np.array(
            [way, np.cross([0.0, 0.0, 1.0], way), [0.0, 0.0, np.linalg.norm(way)]]
        )
        turn /= np.linalg.norm(turn, axis=1, keepdims=True)
        with np.errstate(divide="ignore", invalid="ignore"):
            eyes, rays = (pulses.eyes[rows] - middle) @ turn.T, pulses.rays[rows] @ turn.T
            half = 0.5 * one.size
            low, high = (-half - eyes) / rays, (half - eyes) / rays
        enters, leaves = np.minimum(low, high).max(axis=1), np.maximum(low, high).min(axis=1)
        is_met = (enters < leaves) & (enters > 0.2)
        nearest[rows] = np.where(is_met, np.minimum(nearest[rows], enters), nearest[rows])
    return nearest


class Maker:
    """Makes scans of scenes in which something moves."""

    def __init__(self, data: Path, folder: Path) -> None:
        self._worlds, self._folder = load_tool(data, "make_worlds"), folder

    def rooms_by_tripods(self, rng: Random) -> Scene:
        """Each stand sees one to three walkers, most of whom stand."""
        mesh, stands = self._plan(rng, 2)
        return self._stand(mesh, stands, rng, lambda begin: self._walk(rng, stands, begin, 0.3))

    def streets_by_tripods(self, rng: Random) -> Scene:
        """Walkers on the pavements, cars that wait or pass."""
        mesh, length, wide = self._worlds.street(rng)
        n = int(rng.integers(3, 5))
        across = rng.uniform(3.2, wide - 3.2, n)
        stands = np.column_stack([np.linspace(0.15, 0.85, n) * length, across, np.full(n, 1.7)])
        return self._stand(mesh, stands, rng, lambda begin: self._pass(rng, length, wide, begin))

    def rooms_by_hand(self, rng: Random) -> Scene:
        """A spinning scanner is carried to and fro; walkers come and go."""
        mesh, stands = self._plan(rng, 3)
        turns = np.concatenate([stands, stands[::-1], stands])
        movers = [m for at in np.arange(0.0, 60.0, 15.0) for m in self._walk(rng, stands, at, 0.5)]
        return self._spin(mesh, turns, 0.7, rng, movers)

    def streets_by_car(self, rng: Random) -> Scene:
        """A spinning scanner is driven there and back."""
        mesh, length, wide = self._worlds.street(rng)
        y = np.array([0.4, 0.6, 0.4, 0.6]) * wide
        turns = np.column_stack([np.array([1, length - 1, 1, length - 1]), y, np.full(4, 2.2)])
        movers = [
            m for at in np.arange(0.0, 60.0, 8.0) for m in self._pass(rng, length, wide, at, 8.0)
        ]
        return self._spin(mesh, turns, 4.0, rng, movers)

    def _plan(self, rng: Random, least: int) -> tuple[Any, FloatArray]:
        stands: Any = ()
        while len(stands) < least:
            mesh, stands, _, _ = self._worlds.plan(rng)
        return mesh, stands[rng.permutation(len(stands))[:4]]

    def _walk(self, rng: Random, stands: FloatArray, begin: float, moving: float) -> list[Mover]:
        """Return people between places where a tripod could stand, on the floor."""
        people = []
        for _ in range(rng.integers(1, 4)):
            at = rng.random()
            one, other = stands[rng.integers(0, len(stands), 2)]
            start = (one + at * (other - one) + rng.normal(0.0, 0.6, 3)) * [1, 1, 0]
            speed = rng.normal(0.0, 0.6, 3) * [1, 1, 0] * (rng.random() < moving)
            people.append(
                Mover(WALKER, start + 0.5 * WALKER * [0, 0, 1], speed, begin, begin + TURN_S)
            )
        return people

    def _pass(
        self, rng: Random, length: float, wide: float, begin: float, stay: float = TURN_S
    ) -> list[Mover]:
        movers = []
        for _ in range(rng.integers(1, 4)):
            y = rng.choice([0.8, wide - 0.8]) if rng.random() < 0.7 else rng.uniform(1, wide - 1)
            speed = np.array([rng.uniform(-1.5, 1.5), 0, 0]) * (rng.random() < 0.6)
            start = np.array([rng.uniform(0, length), y, 0.5 * WALKER[2]])
            movers.append(Mover(WALKER, start, speed, begin, begin + stay))
        for _ in range(rng.integers(0, 3)):
            y, waits = rng.uniform(0.35, 0.65) * wide, rng.random() < 0.5
            start = np.array([rng.uniform(0.2, 0.8) * length if waits else 0.0, y, 0.8])
            speed = np.array([0.0 if waits else rng.uniform(1, 8), 0, 0])
            movers.append(Mover(CAR, start, speed, begin, begin + stay))
        return movers

    def _stand(
        self, mesh: Any, stands: FloatArray, rng: Random, people: Callable[[float], list[Mover]]
    ) -> Scene:
        path, has_moved = self._folder / "scan.ptx", []
        step = self._worlds.between(rng, 0.15, 0.4)
        with path.open("w", encoding="utf-8") as file:
            for number, stand in enumerate(stands):
                rays = self._worlds.scanners.tripod_rays(step, -60.0)
                begin = number * MOVE_S
                turned = np.arctan2(rays[:, 1], rays[:, 0]) / (2 * np.pi) + 0.5
                eyes = np.tile(stand, (len(rays), 1))
                movers = [m for m in people(begin) if self._is_free(m, stand)]
                points, _, moved = self._look(
                    mesh, Pulses(eyes, rays, begin + TURN_S * turned), movers, rng
                )
                place = " ".join(f"{x:.4f}" for x in stand)
                file.write(f"{len(points)}\n1\n{place}\n1 0 0\n0 1 0\n0 0 1\n")
                file.write(f"1 0 0 0\n0 1 0 0\n0 0 1 0\n{place} 1\n")
                np.savetxt(
                    file, np.column_stack([points - stand, np.full(len(points), 0.5)]), "%.4f"
                )
                has_moved.append(moved)
        return Scene((), path, np.concatenate(has_moved))

    def _spin(
        self, mesh: Any, turns: FloatArray, speed: float, rng: Random, movers: list[Mover]
    ) -> Scene:
        sides = np.linalg.norm(np.diff(turns, axis=0), axis=1)
        at = np.append(0.0, np.cumsum(sides)) / speed
        times = np.arange(0.0, at[-1], 1.0 / RATE_HZ)
        eyes = np.column_stack([np.interp(times, at, turns[:, k]) for k in range(3)])
        eyes[:, 2] += 0.05 * np.sin(2 * np.pi * 1.8 * times)  # of steps
        azimuth = 2 * np.pi * TURNS_HZ * times
        beam = np.radians(-50 + 100 * (np.arange(len(times)) % BEAMS) / (BEAMS - 1))
        flat = np.cos(beam)
        rays = np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(beam)])
        tilt = 0.3 * np.sin(2 * np.pi * 0.15 * times)  # of the hand, about x
        rays = np.column_stack([
            rays[:, 0], np.cos(tilt) * rays[:, 1] - np.sin(tilt) * rays[:, 2],
            np.sin(tilt) * rays[:, 1] + np.cos(tilt) * rays[:, 2],
        ])  # fmt: skip
        pulses = Pulses(eyes, rays, times)
        movers = [m for m in movers if self._is_free(m, *eyes[::4000])]
        points, hit_times, moved = self._look(mesh, pulses, movers, rng)
        path, way = self._folder / "scan.npz", self._folder / "way.csv"
        np.savez(path, xyz=points, gps_time=hit_times)
        rows = slice(None, None, int(RATE_HZ / 10))
        np.savetxt(
            way, np.column_stack([times, eyes])[rows], "%.4f", ",", header="time,x,y,z", comments=""
        )
        return Scene(("--viewpoint", str(way)), path, moved)

    def _is_free(self, mover: Mover, *eyes: FloatArray) -> bool:
        """Tell whether a mover stays so far from scanners that it does not walk through one."""
        ways = mover.start + np.linspace(0, mover.end - mover.begin, 50)[:, None] * mover.speed
        gaps = np.linalg.norm((ways[:, None] - np.stack(eyes))[..., :2], axis=-1)
        return bool(gaps.min() > 0.7 * max(mover.size[:2]))

    def _look(
        self, mesh: Any, pulses: Pulses, movers: Sequence[Mover], rng: Random
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return points (n, 3), their times, and which of them are of movers."""
        caster = self._worlds.scanners.Caster(*mesh)
        face, depth = caster.cast(pulses.eyes, pulses.rays)
        still = np.where((face >= 0) & (depth > 0.3), depth, np.inf)
        moved = meet(movers, pulses)
        far = np.minimum(still, moved)
        rows = np.flatnonzero((far < REACH) & (rng.random(len(far)) > 0.02))
        measured = far[rows] + rng.normal(0.0, NOISE, len(rows))
        points = pulses.eyes[rows] + measured[:, None] * pulses.rays[rows]
        return points, pulses.times[rows], moved[rows] < still[rows]


def judge(scene: Scene) -> list[int]:
    """Return how many points are of movers, how many of those go, of the rest, and of those go."""
    source = open_points(scene.path)
    whole = read_whole(source)
    gone = are_seen_through(whole, look_around(source, find_path(parse_viewpoint(scene.words[1:]))))
    moved = scene.has_moved
    counts = (moved, gone & moved, ~moved, gone & ~moved)
    return [int(one.sum()) for one in counts]


FAMILIES = ("rooms_by_tripods", "streets_by_tripods", "rooms_by_hand", "streets_by_car")


def main() -> None:
    """Print each scene and write the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--only", default="")
    asked = parser.parse_args()
    rows: list[Row] = []
    for family in FAMILIES:
        if not re.search(asked.only, family):
            continue
        sums = np.zeros(4, dtype=np.int64)
        for number in range(asked.count):
            rng = np.random.default_rng([asked.seed, FAMILIES.index(family), number])
            with tempfile.TemporaryDirectory() as folder:
                maker = Maker(Path(os.environ["HPCAPP_DATA"]), Path(folder))
                counts = judge(getattr(maker, family)(rng))
            sums += counts
            moved, gone, rest, lost = counts
            print(f"{family} {number}: {moved:8,} moved, {gone / max(moved, 1):.3f} gone; "
                  f"of {rest:,} others {lost / rest:.5f}", flush=True)  # fmt: skip
        moved, gone, rest, lost = sums.tolist()
        rows.append([
            family.replace("_", " "), asked.count, moved, round(gone / moved, 3),
            round(100 * lost / rest, 3),
        ])  # fmt: skip
    print(rows)
    write_table(
        asked.output,
        "Points of what moved while a scene was scanned: how many go, and how many of the rest",
        ("scenes", "count", "points of movers", "share that goes", "% of the rest that goes"),
        rows,
    )


if __name__ == "__main__":
    main()
