from __future__ import annotations

import numpy as np
import pytest

from hpcapp.geometry.points import PointCloud
from hpcapp.io.batches import batch_points


def _make(start: int, stop: int) -> PointCloud:
    numbers = np.arange(start, stop, dtype=np.float64)
    rows = np.repeat(numbers[:, None], 3, axis=1)
    return PointCloud(rows, -rows, rows.astype(np.uint8), {"intensity": numbers})


@pytest.mark.parametrize("sizes", [[10], [0, 3, 0, 7], [1] * 10, [4, 4, 2], [0, 10, 0]])
@pytest.mark.parametrize("rows", [1, 2, 3, 5, 10, 99])
def test_all_parts_but_the_last_have_so_many_points(sizes: list[int], rows: int) -> None:
    ends = np.cumsum(sizes).tolist()
    parts = list(batch_points((_make(e - n, e) for e, n in zip(ends, sizes, strict=True)), rows))
    assert all(len(part) == rows for part in parts[:-1])
    assert 0 < len(parts[-1]) <= rows
    whole = _make(0, 10)
    for name in ("positions", "normals", "colours"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, getattr(whole, name))
    joined = np.concatenate([part.attributes["intensity"] for part in parts])
    np.testing.assert_array_equal(joined, whole.attributes["intensity"])


def test_no_points_are_one_empty_part() -> None:
    parts = list(batch_points([_make(0, 0), _make(0, 0)], 5))
    assert [len(part) for part in parts] == [0]
    assert parts[0].normals is not None
    assert list(parts[0].attributes) == ["intensity"]
