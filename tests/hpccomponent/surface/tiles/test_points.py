from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hpccomponent.protocol.blobs import make_blob
from hpccomponent.protocol.codec import encode_values
from hpccomponent.runtime.tasks import traits_of
from hpccomponent.surface.cloud.arranged import arrange_cloud
from hpccomponent.surface.tasks.tiles import mesh_gap, mesh_tile, sum_tile
from hpccomponent.surface.tiles.points import PointsThere, estimate_work, pack_cloud
from hpccomponent.surface.types.points import PointCloud


def test_a_tiles_work_is_known_whichever_way_its_points_go() -> None:
    points = np.random.default_rng(1).random((5000, 3)) * (1.0, 0.0, 0.0)
    arranged = arrange_cloud(PointCloud(points, points))
    packed = pack_cloud(arranged.arrangement, arranged.points)
    shared = make_blob(*encode_values((packed,)))
    sent: Any  # on the master a shared value is a blob still
    for sent in ((packed,), (shared,), (packed, shared)):
        work = estimate_work(sent)
        assert work == pytest.approx(5000 * len(sent), rel=0.1)  # blocks have their own bytes
    whole: Any = make_blob(*encode_values(((packed, packed),)))
    assert estimate_work(whole) == pytest.approx(10_000, rel=0.1)
    cells = np.arange(7), np.arange(3)
    assert estimate_work(PointsThere("/nowhere", cells)) == 11.0
    nothing = pack_cloud(arranged.arrangement, arranged.points.take(np.empty(0, np.int64)))
    assert estimate_work((nothing,)) > 0.0


def test_tasks_tell_what_they_cost_by_their_arguments() -> None:
    few, many = (PointsThere("/nowhere", (np.arange(count),)) for count in (10, 1000))
    keys = np.arange(4)
    for task, before in ((sum_tile, ((),)), (mesh_tile, ((),)), (mesh_gap, ((), keys))):
        cost = traits_of(task).cost
        assert cost is not None
        assert 0.0 < 50.0 * cost(*before, few, None) < cost(*before, many, None)
