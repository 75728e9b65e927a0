"""Figures 7 and 8: which runs are made, and how they are summed up."""

from __future__ import annotations

from pathlib import Path

import pytest
from spheres import make_sphere

from hpcapp.io import write_points
from hpcapp.lab.reproduce.scaling import ScalingRun, limit_of_fits, measure, summarise
from hpccomponent.errors import UsageError


def runs_of(slow_round: float) -> list[ScalingRun]:
    return [
        ScalingRun("fits", workers, number, 0.0, 0.0, slow * fit_s, slow * job_s, 0)
        for number, slow in enumerate((1.0, slow_round, 1.0))
        for workers, fit_s, job_s in ((0, 0.1, 1.0), (1, 0.2, 1.1), (2, 0.4, 1.3))
    ]


@pytest.mark.slow
def test_rounds_go_forth_and_back(tmp_path: Path) -> None:
    write_points(tmp_path / "sphere.ply", make_sphere(3000, 2.0))
    found = list(measure(tmp_path / "sphere.ply", 16, 2, 1, backend="threads"))
    assert [(run.round, run.workers, run.way) for run in found] == [
        (0, 0, "fits"), (0, 0, "tiles"), (0, 1, "fits"), (0, 1, "tiles"),
        (1, 1, "fits"), (1, 1, "tiles"), (1, 0, "fits"), (1, 0, "tiles"),
    ]  # fmt: skip
    assert all(0.0 < run.fit_s < run.job_s and run.first_fit_s > 0.0 for run in found)
    assert all((run.start_s > 0.0) == (run.workers > 0) for run in found)


@pytest.mark.slow
def test_real_workers_get_every_point_once(tmp_path: Path) -> None:
    write_points(tmp_path / "sphere.ply", make_sphere(3000, 2.0))
    sent = {
        (run.way, run.workers): run.bytes_sent for run in measure(tmp_path / "sphere.ply", 16, 1, 1)
    }
    assert sent["fits", 0] == sent["tiles", 0] == 0
    points = 3000 * 2 * 3 * 8  # a position and a normal of float64 each
    assert points < sent["fits", 1] < 1.5 * points


def test_a_slow_round_leaves_the_speedups_alone() -> None:
    summaries = summarise(runs_of(10.0))
    assert [line.workers for line in summaries] == [0, 1, 2]
    for line, job in zip(summaries, (1.0, 1 / 1.1, 1 / 1.3), strict=True):
        spread = line.job_speedup
        assert (spread.low, spread.median, spread.high) == pytest.approx([job] * 3)


def test_speedups_need_the_master_alone_in_every_round() -> None:
    with pytest.raises(UsageError, match="without workers"):
        summarise([run for run in runs_of(1.0) if (run.round, run.workers) != (1, 0)])


@pytest.mark.parametrize("share", [0.0, 0.05, 0.5, 1.0])
def test_the_limit_is_that_of_amdahl(share: float) -> None:
    limits = [limit_of_fits(share, workers) for workers in range(9)]
    assert limits[0] == limits[1] == 1.0
    assert limits == sorted(limits)
    assert all(limit * (1.0 - share) <= 1.0 for limit in limits)
    assert all(limit <= workers for workers, limit in enumerate(limits[1:], start=1))
