"""A pass is cut into pieces that share a cloud's blocks, about evenly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.cutting import cut_even, cut_regions
from hpcapp.applications.surface.cloud.point_workers import PassWatch, PointWorkers
from hpcapp.backends.serial import SerialExecutor
from hpcapp.geometry.points import PointCloud
from hpcapp.progress import Progress, ProgressObserver, StageClock
from hpcapp.workforce import Workforce


@given(st.lists(st.integers(1, 9), min_size=1), st.integers(1, 30))
def test_runs_of_blocks_are_about_even(counts: list[int], pieces: int) -> None:
    runs = cut_even(np.array(counts), pieces)
    assert [count for run in runs for count in counts[run]] == counts
    assert len(runs) <= pieces
    assert all(sum(counts[run]) <= sum(counts) / pieces + max(counts) for run in runs)


def test_regions_share_the_blocks() -> None:
    positions = np.random.default_rng(4).normal(size=(9_000, 3))
    cloud = arrange_cloud(PointCloud(positions, positions))
    regions = cut_regions(cloud.keys, cloud.counts, 7)
    assert len(regions) == 7
    assert np.sort(np.concatenate(regions)).tolist() == cloud.keys.tolist()


@pytest.mark.parametrize(
    ("workers", "in_process", "points", "pieces"),
    [
        (1, True, 10_000_000, 7),  # as memory asks for
        (2, False, 10_000_000, 8),  # and as many for each worker
        (3, False, 10_000_000, 9),
        (4, False, 6_000_000, 4),
        (16, False, 10_000_000, 16),
        (16, False, 100_000, 16),
        (16, False, 0, 16),
        (2, False, 100_000_000, 68),
    ],
)
def test_pieces_follow_workers_and_memory(
    workers: int, in_process: bool, points: int, pieces: int
) -> None:
    workforce = Workforce(SerialExecutor(), workers, 4, in_process)
    assert PointWorkers(workforce, True, 1_500_000).count_pieces(points) == pieces


@pytest.mark.parametrize(
    ("workers", "in_process", "points", "ranges"),
    [
        (1, True, 10_000_000, 2),
        (1, True, 100_000_000, 10),  # as memory asks for
        (4, False, 100_000_000, 16),  # and as many for each worker
        (4, False, 1_000_000, 8),
        (4, False, 3, 3),
    ],
)
def test_ranges_are_few(workers: int, in_process: bool, points: int, ranges: int) -> None:
    """They take less memory than pieces, and each is looked into for every region."""
    workforce = Workforce(SerialExecutor(), workers, 4, in_process)
    cut = PointWorkers(workforce, True, 1_500_000).cut_rows(points)
    assert len(cut) == ranges
    assert sum(some.stop - some.start for some in cut) == points
    assert max(some.stop - some.start for some in cut) <= 8 * 1_500_000


class Told(ProgressObserver):
    def __init__(self) -> None:
        self.advances: list[tuple[str, int, int]] = []

    def on_advance(self, stage: str, done: int, total: int) -> None:
        self.advances.append((stage, done, total))


@given(st.lists(st.integers(1, 5), min_size=1, max_size=6), st.integers(1, 6))
def test_a_stage_of_several_passes_tells_how_far_it_has_come(
    regions: list[int], expected: int
) -> None:
    told = Told()
    clock = StageClock(Progress(told))
    watch = PassWatch(clock.progress, {"clean": expected})
    list(watch.follow("ab", 2))  # of no stage
    for _ in range(2):
        told.advances.clear()
        with clock.stage("clean"):
            for count in regions:
                assert list(watch.follow(range(count), count)) == list(range(count))
        assert len(told.advances) == sum(regions)
        hundredths = [
            done for stage, done, total in told.advances if (stage, total) == ("clean", 100)
        ]
        assert hundredths == sorted(hundredths)
        assert hundredths[-1] == 100 * len(regions) // max(expected, len(regions) + 1)
        with clock.stage("other"):
            list(watch.follow("c", 1))
        assert told.advances[-1][0] == "clean"
