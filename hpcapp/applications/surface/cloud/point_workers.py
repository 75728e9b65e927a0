"""Who goes through a cloud in a folder, wherever they see it, and how much of it at once.

Where the workers do not see the folder, tasks that know their region's margin are sent points, and
the rest runs in this process: it is done sooner than the points have travelled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, TypeVar

from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.cloud.cutting import cut_even, cut_regions
from hpcapp.applications.surface.cloud.folder.disk import DiskCloud
from hpcapp.applications.surface.cloud.regions import SentBlocks, StoredBlocks, pack_region
from hpcapp.applications.surface.cloud.tasks import count_block_cells, merge_cells
from hpcapp.backends.serial import SerialExecutor
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.progress import Progress
from hpcapp.workforce import Workforce, map_batches, stream_batches
from hpccomponent.cutting import cut_equal
from hpccomponent.dataclass import dataclass

Result = TypeVar("Result")

_RANGE_PIECES = 8
"""Pieces whose points a range may have: sorted and packed a point takes 70 bytes, in the tasks of
a piece up to 800 (see `resolution.memory`)."""


class PassWatch:
    """Tells how far stages have come that go through a cloud, so many times each or more often.

    A stage that `passes` does not name tells nothing; nobody is told by default.
    """

    def __init__(
        self, progress: Progress | None = None, passes: Mapping[str, int] | None = None
    ) -> None:
        self._progress, self._passes = progress or Progress(), passes or {}
        self._stage, self._ended = "", 0

    def follow(self, results: Iterable[Result], regions: int) -> Iterator[Result]:
        """Yield the results of one pass, as many as it has regions."""
        if self._progress.stage != self._stage:
            self._stage, self._ended = self._progress.stage, 0
        expected = self._passes.get(self._stage)
        for done, result in enumerate(results, 1):
            if expected is not None:
                # In hundredths of the stage; as if one more pass were to come where there are more.
                gone = self._ended + done / regions
                self._progress.advance(int(100 * gone / max(expected, gone + 1.0)), 100)
            yield result
        self._ended += 1


@dataclass(frozen=True, slots=True, eq=False)
class PointWorkers:
    """Who goes through a cloud, in tasks that hold about so many points at most.

    They see the cloud's folder if `workers_see`, and the input if `workers_see_input`.
    """

    workforce: Workforce
    workers_see: bool
    points: int
    workers_see_input: bool = True

    def count_pieces(self, points: int) -> int:
        """Return into how many pieces a pass through so many points is cut.

        No more than memory asks for, so that margins are few, but as many for each worker.
        """
        workers = self._seeing.workers
        return workers * -(-max(points, 1) // (workers * self.points))

    def cut_rows(self, rows: int) -> list[slice]:
        """Cut the records of a file into ranges.

        As few as memory allows, for each becomes a file, which is looked into for every region;
        but two for each worker, so that nobody waits long for the last.
        """
        workers = 2 * self._seeing.workers
        ranges = workers * -(-rows // (workers * _RANGE_PIECES * self.points))
        return cut_equal(rows, min(max(ranges, workers), max(rows, 1)))

    def cut_blocks(self, counts: IntArray) -> list[slice]:
        """Cut blocks, each with so many points, into runs: see `cut_even`."""
        return cut_even(counts, self.count_pieces(int(counts.sum())))

    def map(self, task: Callable[..., Any], batches: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Run a task that reads and writes the folder by itself; see `map_batches`."""
        return map_batches(self._seeing, task, batches)

    def run(
        self,
        task: Callable[..., Any],
        cloud: DiskCloud,
        margin: float,
        given: Sequence[Any],
        target: Path | None,
        watch: PassWatch,
    ) -> Iterator[tuple[int, bool, Any]]:
        """Run a task over the regions of a cloud, and yield results as they come.

        Without a margin regions are runs of blocks. Records in `given` are shared; what changes is
        written to `target`. With each result come the index of its region, in the order of the
        blocks where these are runs, and whether what has changed is written already. The `watch`
        is told of each.
        """
        if margin:
            regions = cut_regions(cloud.keys, cloud.counts, self.count_pieces(len(cloud)))
        else:
            regions = [cloud.keys[run] for run in self.cut_blocks(cloud.counts)]
        sees = self.workers_see or not margin
        workforce = self.workforce if margin else self._seeing
        shared = [workforce.share(value) if is_dataclass(value) else value for value in given]

        def batches() -> Iterator[tuple[Any, ...]]:
            for index, blocks in enumerate(regions):
                where: str | SentBlocks = str(cloud.folder)
                if not sees:
                    where = pack_region(cloud, blocks, margin)
                part = None if target is None or not sees else (str(target), index)
                yield StoredBlocks(where, blocks, margin, part), *shared

        # What is sent waits in memory: one region more than there are workers.
        at_once = len(regions) if sees else workforce.workers + 1
        results = stream_batches(workforce, task, batches(), max(at_once, 1))
        for index, result in watch.follow(results, len(regions)):
            yield index, sees, result

    def count_cells(
        self, cloud: ArrangedCloud, origin: FloatArray, size: float
    ) -> tuple[IntArray, IntArray]:
        """Count all points as `count_block_cells` does; threads share a cloud in memory."""
        runs = [cloud.keys[run] for run in self.cut_blocks(cloud.counts)]
        asked = [(cloud.place, keys, origin, size) for keys in runs]
        return merge_cells(self.map(count_block_cells, asked))

    @property
    def _seeing(self) -> Workforce:
        """Who runs tasks that read and write the folder."""
        return self.workforce if self.workers_see else _HERE


_HERE = Workforce(SerialExecutor(), in_process=True)
