"""What a job sends is counted by what it is, and nothing is left out."""

from __future__ import annotations

from pathlib import Path

import big_cloud
import numpy as np
import pytest
import traffic


def test_bytes_are_those_of_the_codec() -> None:
    assert traffic.count_bytes(np.zeros(10_000)) == pytest.approx(80_000, abs=50)
    assert 90 < traffic.count_bytes((np.zeros(10), 1, "name")) < 110


def test_points_and_halos_are_told_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    big_cloud.write_cloud(tmp_path / "a.ply", 80_000)
    counted = traffic.measure(tmp_path / "a.ply", 3, 64)
    assert (counted.points, counted.tiles) == (80_000, 3)
    assert counted.sent["sum_tile: own points"] / 80_000 == pytest.approx(24.0, rel=0.15)
    halo = counted.sent["sum_tile: halo"] + counted.sent["mesh_tile: halo"]
    assert 0 < halo < 3 * 24.0 * 80_000
    assert counted.sent["solve_far: far field"] > 64 * 100  # what each coarse cell has sampled
    traffic.print_table(counted)
    *rows, _, verdict = capsys.readouterr().out.splitlines()
    assert [row.split("|")[1].strip() for row in rows[2:]] == list(traffic.PARTS)
    assert verdict.startswith("80000 points, 3 tiles")
