"""Regions share a cloud's blocks, and know enough of what is around them."""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.cloud_regions import cut_regions, take_region
from hpccomponent.surface.arranged_cloud import arrange_cloud
from hpccomponent.surface.normals import MARGIN, find_turned, turn_region
from hpccomponent.surface.points import FloatArray, PointCloud
from hpccomponent.surface.spacing import estimate_spacing


def _cloud(seed: int) -> FloatArray:
    """A sphere that is dense on one side, with a patch beside it and points far away."""
    random = np.random.default_rng(seed)
    sphere = random.normal(size=(9_000, 3))
    sphere /= np.linalg.norm(sphere, axis=1)[:, None]
    sphere = sphere[random.random(len(sphere)) < 10.0 ** (-0.8 * (1 - sphere[:, 2]))]
    patch = random.uniform(-0.3, 0.3, (40, 3)) * (1.0, 1.0, 0.01) - (0.0, 0.0, 1.3)
    return np.concatenate([sphere, patch, random.uniform(-2, 2, (80, 3))])


def test_turned_normals_of_regions_are_those_of_the_whole() -> None:
    random = np.random.default_rng(0)
    positions = _cloud(3)
    normals = positions / np.linalg.norm(positions, axis=1)[:, None]
    normals[random.random(len(normals)) < 0.1] *= -1.0
    arranged = arrange_cloud(PointCloud(positions, normals))
    spacing = estimate_spacing(positions)
    assert arranged.cloud.normals is not None
    whole = (arranged.cloud.positions, arranged.cloud.normals)
    expected = find_turned(*whole, arranged.low, spacing)
    turned = np.zeros(len(positions), np.bool_)
    rows = np.repeat(arranged.keys, arranged.counts)
    regions = cut_regions(arranged.keys, arranged.counts, 700)
    assert len(regions) > 3
    for blocks in regions:
        r = take_region(arranged, blocks, MARGIN * spacing)
        points = (r.positions, r.normals, r.own)
        turned[np.isin(rows, blocks)] = turn_region(*points, arranged.low, spacing)
    assert turned.tolist() == expected.tolist()
    assert turned.sum() > 100


def test_regions_share_the_blocks_and_know_their_margins() -> None:
    cloud = arrange_cloud(PointCloud(_cloud(4), _cloud(4)))
    regions = cut_regions(cloud.keys, cloud.counts, 500)
    assert np.sort(np.concatenate(regions)).tolist() == cloud.keys.tolist()
    rows = np.repeat(cloud.keys, cloud.counts)
    for blocks in regions:
        for margin in (0.0, 0.3 * cloud.arrangement.edge, 5.0 * cloud.arrangement.edge):
            region = take_region(cloud, blocks, margin)
            own = region.positions[region.own]
            held = cloud.cloud.positions[np.isin(rows, blocks)]
            assert own.tobytes() == held.tobytes()
            taken = {tuple(place) for place in region.positions.tolist()}
            away = np.abs(cloud.cloud.positions[:, None] - own).max(axis=2).min(axis=1)
            due = {tuple(place) for place in cloud.cloud.positions[away <= margin].tolist()}
            assert due <= taken
            assert len(taken) < len(cloud)
