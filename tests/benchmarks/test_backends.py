"""Pairs of real commands, the smallest that there are."""

from __future__ import annotations

from pathlib import Path

import backends
import big_cloud


def test_a_pair_is_the_command_as_typed_and_one_process(tmp_path: Path) -> None:
    big_cloud.write_cloud(tmp_path / "a.ply", 300)
    row = backends.compare_backends(tmp_path / "a.ply", 300, 16, ("--workers", "2"), 1)
    assert (row.backends, row.workers) == (["serial"], [1])
    assert row.wall_ratio > 0.0
    assert row.cpu_ratio > 0.0
    assert "300 points at grid 16" in row.reason or "core(s)" in row.reason
