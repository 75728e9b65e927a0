"""The paper's Figures 7 and 8: what is measured, how it is summed up, and what is written."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import paper_figures
import pytest
from paper_figures import (
    Run,
    find_cloud,
    main,
    measure,
    plot,
    print_table,
    summarise,
)

from hpcapp.applications.surface.paper.method import PaperMethod
from hpcapp.io import read_points, write_points
from hpccomponent.errors import UsageError
from hpccomponent.surface.types.points import PointCloud

SMALL = PaperMethod(patches=8, grid=12)
POINTS = 1500


@pytest.fixture
def sphere(tmp_path: Path) -> Path:
    normals = np.random.default_rng(5).normal(size=(POINTS, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    path = tmp_path / "sphere.ply"
    write_points(path, PointCloud(2.0 * normals, normals))
    return path


def run_of(workers: int, number: int, fit_s: float, job_s: float) -> Run:
    return Run(workers, number, 0.5 * workers, 2.0 * fit_s, fit_s, job_s, 100 * workers)


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    """Three rounds, the second of which a busy machine makes ten times as slow."""
    return [
        run_of(workers, number, slow * fit_s, slow * job_s)
        for number, slow in enumerate((1.0, 10.0, 1.0))
        for workers, fit_s, job_s in ((0, 0.1, 1.0), (1, 0.2, 1.1), (2, 0.4, 1.3))
    ]


@pytest.fixture(scope="module")
def pictures(runs: list[Run], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Drawn outside the test: matplotlib keeps its fonts open, which is no leak of ours."""
    pytest.importorskip("matplotlib", reason="needs the bench extra")
    folder = tmp_path_factory.mktemp("pictures")
    plot(summarise(runs), 2, folder)
    return folder


def test_rounds_go_forth_and_back(sphere: Path) -> None:
    found = list(measure(sphere, 2, 2, SMALL, backend="threads"))
    assert [(run.round, run.workers) for run in found] == [
        (0, 0), (0, 1), (0, 2), (1, 2), (1, 1), (1, 0),
    ]  # fmt: skip
    assert all(0.0 < run.fit_s < run.job_s and run.first_fit_s > 0.0 for run in found)
    assert all((run.start_s > 0.0) == (run.workers > 0) for run in found)


def test_real_workers_get_every_point(sphere: Path) -> None:
    [alone, one] = measure(sphere, 1, 1, SMALL)
    assert alone.bytes_sent == 0
    assert one.bytes_sent > POINTS * 2 * 3 * 8  # a position and a normal of float64 each
    assert one.bytes_sent < 1.5 * POINTS * 2 * 3 * 8  # one fit, not two


def test_a_slow_round_leaves_the_speedups_alone(runs: list[Run]) -> None:
    summaries = summarise(runs)
    assert [line.workers for line in summaries] == [0, 1, 2]
    for line, fit, job in zip(summaries, (1.0, 0.5, 0.25), (1.0, 1 / 1.1, 1 / 1.3), strict=True):
        for spread, expected in ((line.fit_speedup, fit), (line.job_speedup, job)):
            assert (spread.low, spread.median, spread.high) == pytest.approx([expected] * 3)
    assert summaries[1].fit_s.median == 0.2
    assert summaries[1].fit_s.high == 2.0
    assert summaries[2].bytes_sent == 200


def test_speedups_need_the_master_alone_in_every_round(runs: list[Run]) -> None:
    with pytest.raises(UsageError, match="without workers"):
        summarise([run for run in runs if (run.round, run.workers) != (1, 0)])


def test_the_cloud_is_the_given_one(sphere: Path, tmp_path: Path) -> None:
    assert find_cloud(sphere, tmp_path) == sphere
    with pytest.raises(UsageError, match="nowhere"):
        find_cloud(tmp_path / "nowhere.ply", tmp_path)


def test_the_cloud_is_the_papers_where_it_is_at_hand(
    sphere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HPCAPP_DATA", str(tmp_path))
    bunny = sphere.rename(tmp_path / paper_figures.PAPER_CLOUD)
    assert find_cloud(None, tmp_path / "out") == bunny


@pytest.mark.parametrize("is_set", [False, True])
def test_else_it_is_a_scan_of_as_many_points(
    is_set: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HPCAPP_DATA", raising=False)
    if is_set:
        monkeypatch.setenv("HPCAPP_DATA", str(tmp_path))
    monkeypatch.setattr(paper_figures, "PAPER_POINTS", 700)
    cloud = read_points(find_cloud(None, tmp_path / "out"))
    assert len(cloud) == 700
    assert cloud.normals is not None


def test_the_table_has_a_row_for_each_number_of_workers(
    runs: list[Run], capsys: pytest.CaptureFixture[str]
) -> None:
    print_table(summarise(runs))
    head, rule, *rows = capsys.readouterr().out.splitlines()
    assert [row.split("|")[1].strip() for row in rows[:3]] == ["0 (master)", "1", "2"]
    assert {row.count("|") for row in (head, rule, *rows[:3])} == {head.count("|")}
    assert "200 (200 to 2000)" in rows[1]  # ms of the fit
    assert rows[-1] == "the fits are 10.0 % of the job without workers"


@pytest.mark.parametrize("name", ["figure_7_time.png", "figure_8_speedup.png"])
def test_figures_are_small_pictures(name: str, pictures: Path) -> None:
    picture = (pictures / name).read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert len(picture) < 150_000


def test_the_command_writes_every_run(
    sphere: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "new"
    options = ["--rounds", "2", "--workers", "0", "--patches", "8", "--grid", "12"]
    monkeypatch.setattr(sys, "argv", ["paper_figures.py", str(folder), str(sphere), *options])
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)  # as if it were not installed
    main()
    written = json.loads((folder / "paper_figures.json").read_text())
    assert (written["cloud"], written["patches"], written["grid"]) == ("sphere.ply", 8, 12)
    assert [run["round"] for run in written["runs"]] == [0, 1]
    assert written["summaries"][0]["fit_speedup"] == {"median": 1.0, "low": 1.0, "high": 1.0}
    assert "matplotlib is not installed" in capsys.readouterr().out
