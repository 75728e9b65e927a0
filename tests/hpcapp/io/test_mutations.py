"""Damaged LAZ and E57: a cloud or one line, and neither a signal nor a hang of this process."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from mutated_files import GOOD, watch_reading, write_mutations

from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_points

MUTATIONS = 150  # python tests/helpers/mutated_files.py makes more


@pytest.mark.slow
@pytest.mark.parametrize(("suffix", "library"), [(".laz", "lazrs"), (".e57", "pye57")])
def test_whatever_is_damaged(tmp_path: Path, suffix: str, library: str) -> None:
    pytest.importorskip(library, reason=f"{library} is not installed")
    random = np.random.default_rng(3)
    positions = random.normal(size=(5000, 3))
    colours = random.integers(0, 256, (5000, 3)).astype(np.uint8)
    good = [tmp_path / f"{name}{suffix}" for name in ("plain", "coloured")]
    write_points(good[0], PointCloud(positions[:300]))
    write_points(good[1], PointCloud(positions, None, colours, {"intensity": positions[:, 0]}))
    ends = Counter(end for end, *_ in watch_reading(write_mutations(good, MUTATIONS, tmp_path)))
    assert sum(ends.values()) == MUTATIONS
    assert set(ends) <= set(GOOD)
    assert ends["refused"] > MUTATIONS // 3
