"""Passes over a cloud in a folder: tasks that read it there, wherever a worker sees it.

The master merges what they find. Where the workers do not see the folder, tasks that need a
region's points are sent them, and the rest runs in this process.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from hpcapp.backends.serial import SerialExecutor
from hpcapp.workforce import Workforce, cut_equal, map_batches, stream_batches
from hpccomponent.surface.cloud.arranged import ArrangedCloud
from hpccomponent.surface.cloud.disk import DiskCloud
from hpccomponent.surface.cloud.regions import DroppedCells, SentBlocks, pack_region
from hpccomponent.surface.cloud.spacing import search_spacing
from hpccomponent.surface.tasks.blocks import count_block_boxes, count_block_cells, merge_cells
from hpccomponent.surface.tasks.file_ranges import BoxCounts
from hpccomponent.surface.types.lattice import unique_keys
from hpccomponent.surface.types.points import FloatArray, IntArray

__all__ = ["Boxes", "Passes", "cut_even", "measure_spacing", "merge_boxes", "near_edges"]

Boxes = dict[float, tuple[int, int]]
"""By the edge of boxes, the points in a sample of them and how many of these hold some."""


@dataclass(frozen=True, slots=True, eq=False)
class Passes:
    """How to go through a cloud.

    Parameters
    ----------
    workforce : Workforce
        Runs the tasks.
    workers_see : bool
        Whether the workers see the folder.
    points : int
        How many a task may hold at most, about.
    workers_see_input : bool
        Whether they see the input, too.
    """

    workforce: Workforce
    workers_see: bool
    points: int
    workers_see_input: bool = True

    def count_pieces(self, points: int) -> int:
        """Return into how many pieces a pass through so many points is cut.

        No more than memory asks for, so that margins are few, but as many for each worker.

        Parameters
        ----------
        points : int

        Returns
        -------
        int
            A multiple of the number of workers that run the pass.
        """
        workers = self._workforce.workers
        return workers * -(-max(points, 1) // (workers * self.points))

    def cut_rows(self, rows: int) -> list[slice]:
        """Cut the records of a file into ranges.

        They have no margins: two for each piece, so that nobody waits long for the last.

        Parameters
        ----------
        rows : int
            How many records there are.

        Returns
        -------
        list of slice
        """
        return cut_equal(rows, min(2 * self.count_pieces(rows), max(rows, 1)))

    def cut_blocks(self, counts: IntArray) -> list[slice]:
        """Cut blocks, each with so many points, into runs.

        Parameters
        ----------
        counts : ndarray of int64, shape (b,)
            Points in each block.

        Returns
        -------
        list of slice
            See `cut_even`.
        """
        return cut_even(counts, self.count_pieces(int(counts.sum())))

    def map(self, task: Callable[..., Any], batches: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Run a task that reads and writes the folder by itself; see `map_batches`.

        Parameters
        ----------
        task : callable
            A registered task.
        batches : sequence of tuple
            The positional arguments of each call.

        Returns
        -------
        list
            One result per batch.
        """
        return map_batches(self._workforce, task, batches)

    def map_blocks(
        self, task: Callable[..., Any], cloud: DiskCloud, dropped: DroppedCells | None, *more: Any
    ) -> list[Any]:
        """Run a task over runs of blocks (see `tasks.blocks`), given more arguments.

        Parameters
        ----------
        task : callable
        cloud : DiskCloud
        dropped : DroppedCells or None
        *more : object
            What the task is given after its points.

        Returns
        -------
        list
            One result per run, in the order of the blocks.
        """
        offered = None if dropped is None else self._workforce.share(dropped)
        runs = [cloud.keys[run] for run in self.cut_blocks(cloud.counts)]
        return self.map(task, [((str(cloud.folder), keys, offered), *more) for keys in runs])

    def map_regions(
        self,
        task: Callable[..., Any],
        cloud: DiskCloud,
        regions: list[IntArray],
        margin: float,
        dropped: DroppedCells | None,
        more: Callable[[int], tuple[Any, ...]],
    ) -> Iterator[tuple[int, Any]]:
        """Run a task over regions (see `tasks.cleaning`) and yield results as they come.

        Parameters
        ----------
        task : callable
        cloud : DiskCloud
        regions : list of ndarray of int64
            Sorted keys of each region's blocks.
        margin : float
            In length units of the input.
        dropped : DroppedCells or None
        more : callable
            Given the index of a region, returns what the task is given after its points.

        Yields
        ------
        index : int
            Of the region.
        result : object
        """
        offered = None if dropped is None else self.workforce.share(dropped)

        def batches() -> Iterator[tuple[Any, ...]]:
            for index, blocks in enumerate(regions):
                where: str | SentBlocks = str(cloud.folder)
                if not self.workers_see:
                    where = pack_region(cloud, blocks, margin)
                yield (where, blocks, margin, offered), *more(index)

        at_once = len(regions) if self.workers_see else self.workforce.workers + 1
        return stream_batches(self.workforce, task, batches(), max(at_once, 1))

    def count_cells(
        self, cloud: ArrangedCloud, origin: FloatArray, size: float
    ) -> tuple[IntArray, IntArray]:
        """Count the points in the occupied cells of a lattice; see `count_block_cells`.

        Parameters
        ----------
        cloud : ArrangedCloud
        origin : ndarray of float64, shape (3,)
            Corner of a cell.
        size : float
            Of a cell, in length units of the input.

        Returns
        -------
        keys, counts : ndarray of int64, shape (c,)
            Sorted by key.
        """
        runs = [cloud.keys[run] for run in self.cut_blocks(cloud.counts)]
        asked = [(cloud.place, keys, origin, size) for keys in runs]
        return merge_cells(self.map(count_block_cells, asked))

    @property
    def _workforce(self) -> Workforce:
        """Who runs tasks that read and write the folder."""
        return self.workforce if self.workers_see else _HERE


_HERE = Workforce(SerialExecutor(), in_process=True)


def cut_even(counts: IntArray, pieces: int) -> list[slice]:
    """Cut a cloud into runs of whole blocks with about as many points each.

    Parameters
    ----------
    counts : ndarray of int64, shape (b,)
        Points in each block.
    pieces : int
        At most; fewer where blocks are few or uneven.

    Returns
    -------
    list of slice
        Of rows of `counts`.

    Examples
    --------
    >>> cut_even(np.array([3, 4, 9, 1, 1]), 3)
    [slice(0, 2, None), slice(2, 3, None), slice(3, 5, None)]
    """
    ends = np.cumsum(counts)
    wanted = ends[-1] * np.arange(1, pieces) / pieces
    inner = np.searchsorted(ends - 0.5 * counts, wanted)
    bounds = unique_keys(np.concatenate([[0], inner, [len(counts)]])).tolist()
    return [slice(a, b) for a, b in pairwise(bounds)]


def near_edges(edge: float) -> tuple[float, ...]:
    """Return the edges of boxes that are counted together: that one, and the next one tried.

    Parameters
    ----------
    edge : float
        In length units of the input.

    Returns
    -------
    tuple of float
    """
    return edge, 2.0 * edge


def merge_boxes(edges: Sequence[float], found: Sequence[BoxCounts]) -> Boxes:
    """Merge what tasks have counted; each gives an entry for each edge.

    Parameters
    ----------
    edges : sequence of float
        In length units of the input.
    found : sequence of list
        `BoxCounts` of each task.

    Returns
    -------
    dict
        `Boxes`.
    """
    return {
        edge: (
            sum(held for held, _ in counted),
            len(unique_keys(np.concatenate([keys for _, keys in counted]))),
        )
        for edge, *counted in zip(edges, *found, strict=True)
    }


def measure_spacing(
    cloud: DiskCloud,
    passes: Passes,
    box: tuple[int, FloatArray, FloatArray],
    dropped: DroppedCells | None = None,
    known: Boxes | None = None,
) -> float:
    """Estimate the spacing of a cloud in a folder; see `spacing.search_spacing`.

    Parameters
    ----------
    cloud : DiskCloud
    passes : Passes
    box : tuple
        How many points it has, and the corners of the box around them.
    dropped : tuple
        `DroppedCells`; the points in them do not count.
    known : Boxes, optional
        What has been counted already.

    Returns
    -------
    float
        In length units of the input.
    """
    count, low, high = box
    counted = dict(known or {})

    def count_boxes(edge: float, one_in: int, is_distinct: bool) -> tuple[int, int]:
        if is_distinct or edge not in counted:
            edges = (edge,) if is_distinct or counted else near_edges(edge)
            found = passes.map_blocks(
                count_block_boxes, cloud, dropped, low, edges, one_in, is_distinct
            )
            merged = merge_boxes(edges, found)
            if is_distinct:
                return merged[edge]
            counted.update(merged)
        return counted[edge]

    return search_spacing(count_boxes, count, low, high)
