from __future__ import annotations

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.spacing import (
    estimate_spacing,
    sample_box_keys,
    search_spacing,
)
from hpcapp.geometry.lattice import lay_lattice
from hpcapp.geometry.points import PointCloud
from hpccomponent.errors import InputError


@pytest.mark.parametrize("count", [500, 20_000, 500_000])
def test_spacing_follows_the_area_per_point(count: int) -> None:
    """Boxes cover up to twice the area that passes through them, so it errs on the large side."""
    true = np.sqrt(4 * np.pi / count)
    assert 1.0 * true < estimate_spacing(random_directions(count, 0)) < 1.6 * true


def test_spacing_scales_and_moves_with_the_cloud() -> None:
    points = random_directions(3000, 0)
    spacing = estimate_spacing(points)
    assert estimate_spacing(8.0 * points) == pytest.approx(8.0 * spacing)
    assert estimate_spacing(points + 1e4) == pytest.approx(spacing, rel=0.05)


@pytest.mark.parametrize("times", [20, 50])
def test_points_that_repeat_many_times_do_not_lie_closer(times: int) -> None:
    points = random_directions(3000, 0)
    repeated = estimate_spacing(np.repeat(points, times, axis=0))
    assert 0.6 < repeated / estimate_spacing(points) < 1.4


@pytest.mark.parametrize("points", [[[0, 0, 0], [1, 0, 0]], [[0, 0, 0]] * 9 + [[1, 2, 3]]])
def test_a_few_points_have_a_spacing_too(points: list[list[int]]) -> None:
    spacing = estimate_spacing(np.array(points, dtype=float))
    assert 0 < spacing < np.inf


def test_points_at_one_place_are_refused() -> None:
    with pytest.raises(InputError, match="all 10 points lie at one place"):
        estimate_spacing(np.ones((10, 3)))


@pytest.mark.parametrize("times", [1, 30])
@pytest.mark.parametrize("count", [500, 15_000, 450_000])
@pytest.mark.parametrize("group", [7_000, 10**9])
def test_groups_have_the_spacing_of_the_whole(count: int, times: int, group: int) -> None:
    points = random_directions(count // times, 0) * (1.0, 0.5, 0.1)
    cloud = arrange_cloud(PointCloud(np.repeat(points, times, axis=0), np.repeat(points, times, 0)))

    def count_boxes(edge: float, one_in: int, is_distinct: bool) -> tuple[int, int]:
        pieces = -(-len(cloud.keys) // max(group * len(cloud.keys) // len(cloud), 1))
        runs = np.array_split(cloud.keys, pieces)
        some = [cloud.take_blocks(keys)[0] for keys in runs]
        if is_distinct:
            some = [np.unique(positions, axis=0) for positions in some]
        corner = lay_lattice(cloud.low, edge)
        counted = [sample_box_keys(positions, corner, edge, one_in) for positions in some]
        boxes = np.unique(np.concatenate([keys for _, keys in counted]))
        return sum(held for held, _ in counted), len(boxes)

    found = search_spacing(count_boxes, len(cloud), cloud.low, cloud.high)
    assert found == estimate_spacing(cloud.points.positions)


def test_groups_at_one_place_are_refused() -> None:
    with pytest.raises(InputError, match="all 7 points lie at one place"):
        search_spacing(lambda *_: (7, 1), 7, np.ones(3), np.ones(3))
