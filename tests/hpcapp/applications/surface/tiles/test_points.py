from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.arrangement import unpack_points
from hpcapp.applications.surface.tiles.plan import Gap
from hpcapp.applications.surface.tiles.points import PointsThere, estimate_work, pack_cells
from hpcapp.applications.surface.tiles.tasks import mesh_gap, mesh_tile, sum_tile
from hpcapp.geometry.lattice import pack_places, unique_keys
from hpcapp.geometry.points import PointCloud
from hpccomponent.protocol.blobs import make_blob
from hpccomponent.protocol.codec import encode_values
from hpccomponent.runtime.tasks import traits_of


def test_a_tiles_work_is_known_whichever_way_its_points_go() -> None:
    points = np.random.default_rng(1).random((5000, 3)) * (1.0, 0.0, 0.0)
    arranged = arrange_cloud(PointCloud(points, points))
    packed = arranged.take_packed(arranged.keys)
    shared = make_blob(*encode_values((packed,)))
    sent: Any  # on the master a shared value is a blob still
    for sent in ((packed,), (shared,), (packed, shared)):
        work = estimate_work(sent)
        assert work == pytest.approx(5000 * len(sent), rel=0.1)  # blocks have their own bytes
    whole: Any = make_blob(*encode_values(((packed, packed),)))
    assert estimate_work(whole) == pytest.approx(10_000, rel=0.1)
    cells = np.arange(7), np.arange(3)
    assert estimate_work(PointsThere("/nowhere", cells)) == 11.0
    nothing = arranged.take_packed(np.empty(0, np.int64))
    assert estimate_work((nothing,)) > 0.0


def test_groups_of_cells_are_packed_as_they_lie() -> None:
    points = np.random.default_rng(2).normal(size=(5000, 3))
    cloud = arrange_cloud(PointCloud(points, points))
    size = 3.0 * cloud.arrangement.edge
    places = np.floor((cloud.points.positions - cloud.low) / size).astype(np.int64)
    cells = unique_keys(pack_places(places))
    groups = [cells[::3], cells[1::3], np.array([pack_places(np.array([99, 99, 99]))])]
    packed = pack_cells(cloud, cloud.low, size, groups)
    for group, some in zip(groups, packed, strict=True):
        own = np.isin(pack_places(places), group)
        positions, normals = unpack_points(cloud.arrangement, some)
        assert positions.tobytes() == cloud.points.positions[own].tobytes()
        assert normals.tobytes() == cloud.points.normals[own].tobytes()  # type: ignore[index]
        assert some.counts.all()
    assert not len(packed[2])


def test_tasks_tell_what_they_cost_by_their_arguments() -> None:
    few, many = (PointsThere("/nowhere", (np.arange(count),)) for count in (10, 1000))
    gap = Gap(np.zeros((2, 3), np.int64), np.arange(4), *np.empty((2, 0), np.int64))
    for task, before in ((sum_tile, ((),)), (mesh_tile, ((),)), (mesh_gap, ((), gap))):
        cost = traits_of(task).cost
        assert cost is not None
        assert 0.0 < 50.0 * cost(*before, few, None) < cost(*before, many, None)
