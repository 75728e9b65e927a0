#!/usr/bin/env python3
"""Show how sure volumes between two epochs are, and what the numbers that decide do to them.

    benchmarks/volumes.py

Scans of the yard with a heap of 100 m³ and a pit of 20 m³ against scans of the bare yard; the bare
yard against itself; and closed meshes of one shape against each other, which nothing parts but the
scan and the grid. `off` is an error by its uncertainty: at most 1 in 95 % of the rows.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from itertools import combinations

import numpy as np

import hpcapp
from hpcapp.applications.compare.volume import changed, epochs, errors
from hpcapp.applications.compare.volume.measure import Change, SolidChange, Volume
from hpcapp.lab.simulate.raw.scan import RawSettings, scan_scene
from hpcapp.lab.simulate.raw.scenes import HEAP, PIT

PAIRS = 6
NOISES = (0.0, 0.003, 0.03, 0.1, 0.3)
SHAPES = ("bracket", "knot", "gear", "box")
MESHES = (  # noise, points and grid
    (0.0, 20_000, 48), (0.001, 20_000, 48), (0.001, 20_000, 64), (0.004, 20_000, None),
    (0.01, 5_000, None),
)  # fmt: skip


def scan(scene: str, noise: float, seed: int) -> np.ndarray:
    """Return the points of a flight over a scene."""
    settings = RawSettings(points=20_000, noise=noise, seed=seed)
    return scan_scene(scene, "airborne", settings).cloud.positions


def compare(new: np.ndarray, old: np.ndarray) -> Change:
    """Return what changed between two scans."""
    change = hpcapp.compare_epochs(new, old)
    assert isinstance(change, Change)
    return change


def find_off(part: Volume, truth: float) -> float:
    """Return an error in units of the uncertainty that was said."""
    return abs(part.volume - truth) / part.uncertainty


def measure_heaps(noise: float) -> tuple[np.ndarray, float]:
    """Return how far cut, fill and net are off, and the mean uncertainty of net."""
    pairs = [compare(scan("heap", noise, 2 * k), scan("yard", noise, 2 * k + 1))
             for k in range(PAIRS)]  # fmt: skip
    off = [[find_off(c.cut, PIT), find_off(c.fill, HEAP), find_off(c.net, HEAP - PIT)]
           for c in pairs]  # fmt: skip
    return np.array(off), float(np.mean([c.net.uncertainty for c in pairs]))


def count_alarms(noise: float, pairs: int = 12) -> int:
    """Return of how many pairs of scans of one yard a change is told."""
    return sum(
        compare(scan("yard", noise, k), scan("yard", noise, k + 100)).net.area > 0.0
        for k in range(pairs)
    )


def move_constants() -> Iterator[tuple[str, str]]:
    """Yield each number that decides, as it is, halved and doubled; nothing else is moved."""
    yield "as they are", ""
    for name, modules in (
        ("STAYED", (errors, changed)), ("PER_CELL", (epochs,)), ("FEWEST_BLOCKS", (errors,)),
    ):  # fmt: skip
        usual = getattr(modules[0], name)
        for factor in (0.5, 2.0):
            for module in modules:
                setattr(module, name, factor * usual)
            yield name, f"{factor * usual:g}"
        for module in modules:
            setattr(module, name, usual)


def measure_layers() -> Iterator[tuple[str, float]]:
    """Yield the share of the ground of each scene that has several heights."""
    for scene in ("terrain", "yard", "heap", "forest", "town"):
        points = scan(scene, 0.03, 0)
        change = compare(points[::2], points[1::2])
        yield scene, change.layered / change.common


def measure_solids(shape: str) -> list[SolidChange]:
    """Return what changed between meshes of one shape."""
    meshes = [
        hpcapp.reconstruct(
            hpcapp.simulate(shape, points=points, noise=noise, seed=k), grid=grid
        )
        for k, (noise, points, grid) in enumerate(MESHES)
    ]  # fmt: skip
    closed = [mesh for mesh in meshes if mesh.is_watertight]
    changes = [hpcapp.compare_epochs(new, old) for new, old in combinations(closed, 2)]
    return [change for change in changes if isinstance(change, SolidChange)]


def main() -> None:
    """Print the tables."""
    logging.disable()
    print("heap and pit: noise, share of volumes within, farthest off, uncertainty of net")
    for noise in NOISES:
        off, said = measure_heaps(noise)
        print(f"{noise:8.3f}{(off <= 1.0).mean():8.2f}{off.max():8.2f}{said:8.2f}", flush=True)
    print("numbers that decide, at noise 0.03: the same, and yards of 12 that are told to change")
    for name, value in move_constants():
        off, said = measure_heaps(0.03)
        print(f"{name:16}{value:>6}{(off <= 1.0).mean():8.2f}{off.max():8.2f}{said:8.2f}"
              f"{count_alarms(0.03):4}", flush=True)  # fmt: skip
    print(f"share of the ground with several heights (a warning above {epochs.FEW_LAYERS})")
    for scene, share in measure_layers():
        print(f"{scene:8}{share:8.4f}", flush=True)
    print("closed meshes: pairs, told to have changed, farthest off, median uncertainty in %")
    for shape in SHAPES:
        changes = measure_solids(shape)
        ratios = [find_off(change.net, 0.0) for change in changes]
        said = np.median([change.net.uncertainty / change.old.volume for change in changes])
        print(f"{shape:8}{len(ratios):4}{sum(one > 1.0 for one in ratios):4}{max(ratios):8.2f}"
              f"{100.0 * said:8.2f}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
