"""Sweeps of KITTI: four numbers a point, and nothing that says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.points import FloatArray
from hpcapp.io import open_points, read_points
from hpccomponent.errors import InputError


def sweep(columns: int = 4) -> FloatArray:
    rng = np.random.default_rng(0)
    rows = np.column_stack([rng.normal(size=(900, 3)) * (20.0, 20.0, 1.0), rng.random((900, 9))])
    rows[:, 4:] *= 64.0
    return rows[:, :columns]


def test_a_sweep_is_read_in_parts(tmp_path: Path) -> None:
    rows = sweep().astype("<f4")
    rows.tofile(tmp_path / "000000.bin")
    cloud = read_points(tmp_path / "000000.bin")
    assert (cloud.positions + cloud.origin == rows[:, :3]).all()
    assert (cloud.attributes["intensity"] == rows[:, 3]).all()
    assert cloud.normals is None
    source = open_points(tmp_path / "000000.bin")
    assert [len(part) for part in source.chunks(400)] == [400, 400, 100]


@pytest.mark.parametrize("kind", ["noise", "five columns", "double", "cut off", "empty"])
def test_what_is_no_sweep_is_refused(tmp_path: Path, kind: str) -> None:
    content = {
        "noise": np.random.default_rng(0).bytes(16_000),
        "five columns": sweep(5).astype("<f4").tobytes()[:-8],
        "double": sweep().astype("<f8").tobytes(),
        "cut off": sweep().astype("<f4").tobytes()[:-3],
        "empty": b"",
    }
    (tmp_path / "odd.bin").write_bytes(content[kind])
    with pytest.raises(InputError, match=r"odd\.bin: .*float32 each"):
        read_points(tmp_path / "odd.bin")
