"""The margin around a box is what its edge takes: half of it is too little."""

from __future__ import annotations

import pytest
from crop_margin import BOXES, Box, crop_job, measure_edge, simulate_knot

import hpcapp
from hpcapp.api.mesh import Mesh
from hpcapp.applications.surface.job.source import MARGIN
from hpcapp.geometry.points import PointCloud


@pytest.fixture(scope="module")
def knot() -> PointCloud:
    return simulate_knot()


@pytest.fixture(scope="module")
def whole(knot: PointCloud) -> Mesh:
    return hpcapp.reconstruct(knot, "estimate", executor="serial")


@pytest.mark.parametrize(("box", "most"), [(BOXES[0], 0.07), (BOXES[1], 0.065)])
def test_the_edge_is_as_if_the_whole_had_been_meshed(
    knot: PointCloud, whole: Mesh, box: Box, most: float
) -> None:
    for margin in (0.9 * MARGIN, MARGIN, 1.1 * MARGIN):
        assert measure_edge(whole, crop_job(knot, whole, box, margin), box)[0] < most


def test_half_of_the_margin_is_too_little(knot: PointCloud, whole: Mesh) -> None:
    part = crop_job(knot, whole, BOXES[1], MARGIN / 2)
    assert measure_edge(whole, part, BOXES[1])[0] > 0.065
