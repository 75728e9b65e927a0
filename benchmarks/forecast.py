"""What a billion points take on many machines, by measured rates: forecast.py SCALING.json ...

`SCALING.json` are what ``scaling.py`` wrote, two or more, of clouds of different sizes; what
``traffic.py --json`` wrote tells the halo. Every rate is in CPU seconds of the machine that
measured, and a forecast machine has one core that is as fast, or several::

    worker   start + points x point + halo x halo_point        over all cores
    head     start + points x head_point + tiles x head_tile   one core, beside nothing
    folder   points x FOLDER_BYTES, by its bandwidth           shared by all

``docs/explanation/tiles.md`` says what this leaves out.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from hpcapp.applications.surface.methods.method import LARGE_TILE, TILE_POINTS, TILES_EACH
from hpccomponent.foreign_json import decode

MACHINES = (8, 64, 512)
HALO_STEPS = 24.0  # of the grid, around a tile, and so many coarse cells:
HALO_CELLS = 2.0
COARSE_CELLS = 128.0  # along the longest side, about, whatever the grid

#: Bytes of a point in the shared folder, in all passes: the input twice (24), arranged written (24)
#: and read in four passes of the cleaning (24, margins 1.3), cleaned written (24), read twice for
#: spacing and noise, once to count cells, and by both tasks of its tile (24, halos extra); its
#: share of the mesh (two faces and one vertex for 4 points at 10 million and grid 1024: 9 B)
#: written as a part, read, and written.
FOLDER_BYTES = 24 * (2 + 1 + 4 * 1.3 + 1 + 3 + 2) + 3 * 9


@dataclass(frozen=True, slots=True)
class JobSize:
    """How much a job had to do."""

    points: int
    tiles: int = 1


@dataclass(frozen=True, slots=True)
class MeasuredRun:
    """What ``scaling.py`` says of a run."""

    variant: str
    machines: int
    head_cpu_s: float
    worker_cpu_s: list[float]
    report: JobSize


@dataclass(frozen=True, slots=True)
class Scaling:
    """What ``scaling.py`` has written."""

    grid: float
    runs: list[MeasuredRun]


@dataclass(frozen=True, slots=True)
class HaloTraffic:
    """What ``traffic.py`` has counted, in bytes by task and part."""

    tiles: int
    grid: float
    sent: dict[str, float]


@dataclass(frozen=True, slots=True)
class Rates:
    """What a job costs, in CPU seconds: a process, a point of one that has all, one of a halo.

    Likewise the head while it has workers. `halo` is the longest side by a tile's where there is
    one: tiles are taken for squares, halved with four times as many, with a margin all around.
    """

    start: float
    point: float
    halo_point: float
    head_start: float
    head_point: float
    head_tile: float
    halo: float

    def halo_share(self, tiles: float, grid: float) -> float:
        """Return the points in all halos by those of the cloud."""
        return float((1.0 + 2.0 * self.halo * reach(grid) * tiles**0.5) ** 2 - 1.0)


@dataclass(frozen=True, slots=True)
class Forecast:
    """What one job is expected to take; work and folder overlap, the head's time does not."""

    machines: int
    tiles: int
    worker_s: float
    head_s: float
    folder_s: float
    halo_share: float

    @property
    def total_s(self) -> float:
        """From the start of the job to its end."""
        return max(self.worker_s, self.folder_s) + self.head_s

    @property
    def bottleneck(self) -> str:
        """What takes longest."""
        times = {"workers": self.worker_s, "head": self.head_s, "folder": self.folder_s}
        return max(times, key=lambda name: times[name])


def reach(grid: float) -> float:
    """Return how wide a halo is, by the longest side of the cloud."""
    return HALO_STEPS / grid + HALO_CELLS / COARSE_CELLS


def fit_halo(traffic: HaloTraffic) -> float:
    """Return `Rates.halo`."""
    halo = sum(count for name, count in traffic.sent.items() if name.endswith(": halo"))
    share = halo / traffic.sent["sum_tile: own points"]
    margin = 2.0 * reach(traffic.grid) * traffic.tiles**0.5
    return float((np.sqrt(1.0 + share) - 1.0) / margin)


def fit_rates(results: Sequence[Scaling], halo: float) -> Rates:
    """Return the rates that explain ``serial`` and ``shared`` runs best, none of them negative."""
    runs = [(run, result.grid) for result in results for run in result.runs]
    serial = [run for run, _ in runs if run.variant == "serial"]
    shared = [(run, grid) for run, grid in runs if run.variant == "shared"]
    start, point = _solve(
        [[1.0, run.report.points] for run in serial], [run.head_cpu_s for run in serial]
    )
    head_start, head_point, head_tile = _solve(
        [[1.0, run.report.points, run.report.tiles] for run, _ in shared],
        [run.head_cpu_s for run, _ in shared],
    )
    shape = Rates(0, 0, 0, 0, 0, 0, halo)
    halos, rest = [], []
    for run, grid in shared:
        points, work = run.report.points, sum(run.worker_cpu_s)
        halos.append([shape.halo_share(run.report.tiles, grid) * points])
        rest.append(work - start * run.machines - point * points)
    (halo_point,) = _solve(halos, rest)
    return Rates(start, point, halo_point, head_start, head_point, head_tile, halo)


def _solve(rows: list[list[float]], values: list[float]) -> list[float]:
    """Return what is least wrong in proportion to each value, none of it negative."""
    sizes = np.maximum(np.abs(values), 1e-9)
    table = np.array(rows) / sizes[:, None]
    scale = np.maximum(table.max(axis=0), 1e-30)  # points are millions, a start is one
    rates: list[float] = (nnls(table / scale, np.array(values) / sizes)[0] / scale).tolist()
    return rates


def forecast(
    rates: Rates, points: float, grid: float, machines: int, cores: int, folder_mb_s: float
) -> Forecast:
    """Return what a job is expected to take.

    All cores of a machine are at work; the folder gives 10^6 bytes a second to all together.
    """
    workers = machines * cores
    each = max(1, min(TILES_EACH, points // (workers * LARGE_TILE)))
    tiles = int(workers * max(each, np.ceil(points / TILE_POINTS / workers)))
    share = rates.halo_share(tiles, grid)
    work = points * (rates.point + share * rates.halo_point)
    read = points * (FOLDER_BYTES + 2 * 24 * share)
    return Forecast(
        machines,
        tiles,
        rates.start + work / workers,
        rates.head_start + points * rates.head_point + tiles * rates.head_tile,
        read / (1e6 * folder_mb_s),
        share,
    )


def main() -> None:
    """Print the rates, and a line of a Markdown table for each number of machines."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scaling", type=Path, nargs="+", help="of scaling.py")
    parser.add_argument("--traffic", type=Path, required=True, help="of traffic.py --json")
    parser.add_argument("--points", type=float, default=1e9)
    parser.add_argument("--grid", type=float, default=4096.0)
    parser.add_argument("--cores", type=int, default=1, help="of a machine")
    parser.add_argument("--folder", type=float, default=1000.0, help="MB/s, for all together")
    asked = parser.parse_args()
    halo = fit_halo(decode(asked.traffic.read_bytes(), HaloTraffic))
    rates = fit_rates([decode(path.read_bytes(), Scaling) for path in asked.scaling], halo)
    print(", ".join(f"{name} {value:.3g}" for name, value in asdict(rates).items()))
    print("\n| machines | tiles | halo | workers s | folder s | head s | in all | most of it |")
    print("|---|---|---|---|---|---|---|---|")
    for machines in MACHINES:
        job = forecast(rates, asked.points, asked.grid, machines, asked.cores, asked.folder)
        print(f"| {machines} | {job.tiles} | {job.halo_share:.2f} | {job.worker_s:.0f} "
              f"| {job.folder_s:.0f} | {job.head_s:.0f} | {job.total_s / 60:.1f} min "
              f"| {job.bottleneck} |")  # fmt: skip


if __name__ == "__main__":
    main()
