"""Emulated machines are held to their quota, do the job, and leave nothing behind."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import emulated_machines
import pytest
import scaling
from testbed import network

needs_groups = pytest.mark.skipif(
    bool(emulated_machines.missing_quotas()), reason=emulated_machines.missing_quotas() or "-"
)
needs_network = pytest.mark.skipif(
    bool(network.missing()) or not shutil.which("tc"),
    reason=network.missing() or "needs tc of iproute2",
)


def run_of(variant: str, machines: int, wall_s: float, mesh: str = "a") -> scaling.Run:
    report = {"tiles": 4, "bytes_sent": 10**6, "bytes_received": 2 * 10**6}
    used = [1.0] * machines
    return scaling.Run(variant, machines, 0.2, wall_s, 2.0, used, 0.5, mesh, report)


@needs_groups
def test_a_group_counts_what_runs_in_it_and_holds_it_to_its_quota() -> None:
    spin = "import time\nbegan = time.process_time()\nwhile time.process_time() - began < 0.2: pass"
    with emulated_machines.open_group("hpcapp-test", 0.5) as group:
        watch = "import time; print(time.monotonic())"
        words = [sys.executable, "-c", f"{watch}\n{spin}\n{watch}"]
        done = subprocess.run([*group.prefix, *words], check=True, capture_output=True, text=True)
        assert group.is_empty()
        used = group.used_s()
    began, ended = map(float, done.stdout.split())
    assert used >= 0.2
    assert ended - began >= 0.3  # of 0.4 that half a core takes: its first period may be whole


@needs_groups
@pytest.mark.slow
def test_all_variants_give_one_mesh_and_a_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(scaling, "CORES", {2: 0.5})
    words = ["scaling.py", str(tmp_path), "--points", "4000", "--grid", "32", "--rounds", "1"]
    monkeypatch.setattr(sys, "argv", [*words, "--variants", "shared", "fed", "slow", "cores"])
    scaling.main()
    written = json.loads((tmp_path / "scaling.json").read_text())
    found = [(run["variant"], run["machines"]) for run in written["runs"]]
    assert found == [
        ("serial", 0), ("shared", 2), ("slow, equal", 2), ("slow, adaptive", 2), ("fed", 2),
        ("serial", 0), ("cores", 2), ("cores, default", 0),
    ]  # fmt: skip
    assert len({run["mesh"] for run in written["runs"]}) == 1
    assert all(run["head_cpu_s"] > 0.0 for run in written["runs"])
    assert all(used > 0.0 for run in written["runs"] for used in run["worker_cpu_s"])
    head, *rows = capsys.readouterr().out.splitlines()
    assert {row.count("|") for row in (head, *rows)} == {head.count("|")}
    assert len(rows) == len(found)


@needs_groups
@needs_network
@pytest.mark.slow
def test_machines_can_be_had_behind_slow_cables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scaling, "CORES", {2: 0.5})
    words = ["scaling.py", str(tmp_path), "--points", "4000", "--grid", "32"]
    monkeypatch.setattr(sys, "argv", [*words, "--variants", "links"])
    scaling.main()
    alone, linked = json.loads((tmp_path / "scaling.json").read_text())["runs"]
    assert alone["mesh"] == linked["mesh"]
    assert linked["report"]["workers"] == 2
    assert linked["report"]["bytes_sent"] > 24 * 4000


def test_a_run_is_compared_with_the_last_one_of_its_kind() -> None:
    first, other, last = run_of("serial", 0, 9.0), run_of("shared", 4, 3.0), run_of("serial", 0, 8)
    paper, theirs = run_of("paper, serial", 0, 7.0, "b"), run_of("paper", 4, 7.0, "c")
    runs = [first, other, last, run_of("fed", 4, 4.0), paper, theirs]
    assert [scaling.find_base(runs, run) for run in runs] == [
        first, first, last, last, paper, paper,
    ]  # fmt: skip
    scaling.check_mesh(runs)
    with pytest.raises(AssertionError, match="differ"):
        scaling.check_mesh([*runs, run_of("fed", 4, 4.0, "d")])
