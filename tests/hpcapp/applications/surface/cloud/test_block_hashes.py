"""What tells the points of a block from others."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.block_hashes import BlockHashes
from hpcapp.applications.surface.cloud.frame import Frame
from hpcapp.geometry.points import PointCloud


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 799), st.booleans())
def test_a_block_has_another_hash_just_where_a_point_has_changed(row: int, moves: bool) -> None:
    positions, normals = np.random.default_rng(2).uniform(0.1, 0.9, (2, 800, 3))
    before = arrange_cloud(PointCloud(positions, normals), Frame(keeps=True).arrange)
    (positions if moves else normals)[row, 1] += 1e-4
    # Within the room that the first box has, so that the blocks are the same.
    after = arrange_cloud(PointCloud(positions, normals), lambda *_: before.arrangement)
    every = np.union1d(before.keys, after.keys)
    keys, hashes = BlockHashes(before).of(every)
    keys_after, hashes_after = BlockHashes(after).of(every)
    old = dict(zip(keys.tolist(), map(tuple, hashes.tolist()), strict=True))
    new = dict(zip(keys_after.tolist(), map(tuple, hashes_after.tolist()), strict=True))
    changed = {key for key in {*old, *new} if old.get(key) != new.get(key)}
    assert 1 <= len(changed) <= (2 if moves else 1)
