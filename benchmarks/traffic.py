"""What travels to workers that see no folder, by what it is: traffic.py CLOUD TILES [--grid N].

The job runs in this process with an Executor that encodes the arguments of every task by the
protocol's codec, as they go over the wire, and adds up their bytes. A tile's own points go to
both of its tasks, but a worker that has them is not sent them again: they are counted once.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from hpcapp.applications.surface.hierarchical.method import HierarchicalMethod
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.pipeline import load
from hpcapp.backends.serial import SerialExecutor
from hpcapp.progress import Progress, StageClock
from hpcapp.workforce import Workforce
from hpccomponent.protocol.codec import encode_values

P = ParamSpec("P")
R = TypeVar("R")

PARTS = ("own points", "halo", "coarse polynomials", "far field", "the rest")
BYTES_PER_POINT = 24.0  # a position in its block's frame, and a normal; float32
ASKED = 1.15


class CountingExecutor(SerialExecutor):
    """Runs tasks here, and counts the bytes that each gets, as ``"mesh_tile: halo"``."""

    def __init__(self) -> None:
        self.sent: Counter[str] = Counter()

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """Count what a task would be sent, and run it."""
        for part, values in take_apart(fn.__name__, args).items():
            self.sent[f"{fn.__name__}: {part}"] += count_bytes(values)
        return super().submit(fn, *args, **kwargs)


def take_apart(task: str, arguments: tuple[Any, ...]) -> dict[str, object]:
    """Return the arguments of a task by what they are."""
    if task == "sum_tile":
        plan, (points, *halo), *rest = arguments
        return {"own points": points, "halo": halo, "the rest": (plan, rest)}
    if task == "solve_far":
        plan, samples, *_ = arguments
        return {"far field": samples, "the rest": plan}
    if task == "mesh_tile":
        plan, (_, *halo), ticket, coarse, *rest = arguments
        is_there = ticket is not None  # its points, halo and all, since `sum_tile`
        return {
            "halo": () if is_there else halo,
            "coarse polynomials": (coarse.parents, coarse.trust, coarse.coarser),
            "far field": coarse.far, "the rest": (plan, rest),
        }  # fmt: skip
    if task == "mesh_gap":
        plan, bricks, points, missing, coarse, *rest = arguments
        return {
            "halo": points, "coarse polynomials": (coarse.parents, coarse.trust, coarse.coarser),
            "far field": coarse.far,
            "the rest": (plan, bricks, missing, rest),
        }  # fmt: skip
    return {"the rest": arguments}


def count_bytes(values: object) -> int:
    """Return how many bytes some values take on the wire."""
    header, buffers = encode_values((values,))
    return len(header) + sum(memoryview(buffer).nbytes for buffer in buffers)


@dataclass(frozen=True, slots=True)
class Traffic:
    """What a job of some tiles sent, in bytes by task and part."""

    cloud: str
    points: int
    grid: int
    tiles: int
    sent: dict[str, int]


def measure(cloud: Path, tiles: int, grid: int) -> Traffic:
    """Run a job that is cut into some tiles, and count."""
    clock = StageClock(Progress())
    points = load(JobSettings(cloud, "-"), clock).cloud
    executor = CountingExecutor()
    method = HierarchicalMethod(grid)
    workforce = Workforce(executor, tiles)
    partition = method.partition(points, workforce)
    quadrics = method.fit(partition, workforce, lambda _done, _all: None)
    method.extract(partition, quadrics, workforce, lambda _done, _all: None)
    assert partition.tiling is not None
    return Traffic(cloud.name, len(points), grid, len(partition.tiling), dict(executor.sent))


def print_table(traffic: Traffic) -> None:
    """Print one line of a Markdown table for each part."""
    points = traffic.points
    print("| | MB | bytes a point | by 24 B |")
    print("|---|---|---|---|")
    shares = {}
    for part in PARTS:
        sent = sum(count for name, count in traffic.sent.items() if name.endswith(f": {part}"))
        each = sent / points
        shares[part] = each / BYTES_PER_POINT
        print(f"| {part} | {sent / 1e6:.1f} | {each:.2f} | {shares[part]:.3f} |")
    beside = sum(share for part, share in shares.items() if part != "own points")
    of_tiles = shares["own points"]
    print(f"\n{points} points, {traffic.tiles} tiles: own points {of_tiles:.3f} (asked: {ASKED}), "
          f"all else {beside:.3f} (asked: as much again)")  # fmt: skip


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cloud", type=Path)
    parser.add_argument("tiles", type=int)
    parser.add_argument("--grid", type=int, default=1024)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    traffic = measure(asked.cloud, asked.tiles, asked.grid)
    if asked.json:
        asked.json.write_text(json.dumps(asdict(traffic), indent=2) + "\n")
    print_table(traffic)


if __name__ == "__main__":
    main()
