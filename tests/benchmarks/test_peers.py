"""The side-by-side run, with copies of finished meshes in the place of reconstructions."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from clouds import CLOUDS, GROUPS, SimulatedCloud, find_clouds, open_truth
from level_sets import mesh_level_set
from peers import (
    Contender,
    Outcome,
    Usage,
    measure_process,
    print_cloud,
    print_summary,
    ratios,
    run_all,
    tabulate_costs,
)

from hpcapp.io import read_points, write_mesh
from hpcapp.lab.simulate.settings import ScanSettings
from hpccomponent.errors import UsageError

SMALL = SimulatedCloud("sphere-small", "clean", "sphere", ScanSettings(points=500))
COPY = "import shutil, sys; shutil.copy(sys.argv[1], sys.argv[2])"


def write_ball(path: Path, radius: float) -> Path:
    write_mesh(path, mesh_level_set(lambda *at: np.linalg.norm(at, axis=0) - radius, 1.3, 24))
    return path


def copier(name: str, source: Path) -> Contender:
    return Contender(name, [sys.executable, "-c", COPY, str(source), "{output}"])


def test_what_a_process_takes_is_counted(tmp_path: Path) -> None:
    idle = measure_process([sys.executable, "-c", "pass"], tmp_path / "log")
    large = measure_process(
        [sys.executable, "-c", "x = b'x' * 200_000_000; print('done')"], tmp_path / "log"
    )
    assert idle.exit_code == large.exit_code == 0
    assert 150 < large.rss_mb - idle.rss_mb < 250
    assert idle.cpu_s > 0
    assert (tmp_path / "log").read_text() == "done\n"


def test_a_failing_process_is_an_outcome(tmp_path: Path) -> None:
    log = tmp_path / "log"
    assert measure_process([sys.executable, "-c", "raise SystemExit(3)"], log).exit_code == 3


def test_contenders_are_ranked_and_peers_remembered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ours = copier("ours", write_ball(tmp_path / "near.ply", 1.01))
    peer = copier("peer:1", write_ball(tmp_path / "far.ply", 1.02))
    broken = Contender("peer:2", [sys.executable, "-c", "raise SystemExit(1)"])
    [first] = run_all([SMALL], [ours, peer, broken], tmp_path / "kept", samples=2000)
    assert [outcome.contender for outcome in first] == ["ours", "peer:1", "peer:2"]
    own, others = first[0].measures, first[1].measures
    assert own is not None
    assert others is not None
    assert own["l1"] < others["l1"]
    assert own["topology"]["watertight"]
    assert first[2].measures is None
    [again] = run_all([SMALL], [ours, peer, broken], tmp_path / "kept", samples=2000)
    assert again[1].usage == first[1].usage
    print_cloud(again, with_head=True)
    print_summary([again])
    printed = capsys.readouterr().out
    assert "no mesh, exit code 1" in printed
    assert "best of them" in printed


def test_the_best_peer_is_chosen_cloud_by_cloud() -> None:
    def row(name: str, l1: float) -> Outcome:
        return Outcome("a", name, Usage(0, 1.0, 1.0, 1.0), {"l1": l1})

    rows = [
        [row("ours", 1.0), row("a", 2.0), row("b", 4.0)],
        [row("ours", 1.0), row("a", 8.0), row("b", 0.5)],
    ]
    assert ratios(rows, "a", "l1") == [0.5, 0.125]
    assert ratios(rows, "best of them", "l1") == [0.5, 2.0]


def test_costs_are_those_of_a_peer_by_ours() -> None:
    ours = Outcome("a", "ours", Usage(0, 2.0, 1.0, 100.0), None)
    theirs = Outcome("a", "open3d:8", Usage(0, 7.0, 1.0, 250.4), None)
    assert tabulate_costs([[ours, theirs]]) == [["a", 2.0, 7.0, 3.5, 100, 250]]


def test_a_cloud_is_made_once_and_the_same_each_time(tmp_path: Path) -> None:
    first = read_points(SMALL.place(tmp_path / "a"))
    second = read_points(SMALL.place(tmp_path / "b"))
    assert np.array_equal(first.positions, second.positions)
    written = (tmp_path / "a" / "sphere-small.ply").stat().st_mtime_ns
    SMALL.place(tmp_path / "a")
    assert (tmp_path / "a" / "sphere-small.ply").stat().st_mtime_ns == written
    assert open_truth(SMALL).diagonal == pytest.approx(np.sqrt(12))


def test_names_and_groups_find_clouds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert {cloud.group for cloud in CLOUDS.values()} | {"scans"} == set(GROUPS)
    assert [cloud.name for cloud in find_clouds(["knot-clean"])] == ["knot-clean"]
    assert {cloud.group for cloud in find_clouds(["thin", "pose"])} == {"thin", "pose"}
    monkeypatch.delenv("HPCAPP_DATA", raising=False)
    assert not {"real", "scans"} & {cloud.group for cloud in find_clouds([])}
    with pytest.raises(UsageError, match="no cloud or group"):
        find_clouds(["teapot"])
    with pytest.raises(UsageError, match="HPCAPP_DATA"):
        CLOUDS["bunny-36k"].place(tmp_path)
