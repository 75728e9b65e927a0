"""Where the vertices are that a part names and another one gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from directions import random_directions
from passes import measure_read

from hpcapp.applications.surface.boundary.drive import OpeningSettings
from hpcapp.applications.surface.boundary.seams import place_foreign
from hpcapp.applications.surface.hierarchical.method import HierarchicalMethod
from hpcapp.applications.surface.pipeline import make_surface
from hpcapp.applications.surface.stitching.plan import StitchingPlan
from hpcapp.backends.serial import SerialExecutor
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.progress import Progress, StageClock
from hpcapp.workforce import Workforce


def plan_sphere() -> StitchingPlan:
    """Return the plan of a sphere of radius 1 in many tiles."""
    points = random_directions(12_000, 0)
    method = HierarchicalMethod(64, tile_points=500, opening=OpeningSettings("yes"))
    with SerialExecutor() as executor:
        cloud, clock = measure_read(PointCloud(points, points)), StageClock(Progress())
        surface = make_surface(cloud, method, Workforce(executor, in_process=True), clock).surface
    return surface.plan


def test_foreign_vertices_lie_on_the_surface() -> None:
    places: FloatArray = np.concatenate(place_foreign(plan_sphere()))
    assert len(places) > 1_000
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), 1.0, atol=0.02)


def test_a_vertex_that_no_rim_has_is_nowhere() -> None:
    """A copy of a brick that another part gives may name vertices inside of that part."""
    plan = plan_sphere()
    summaries = [
        replace(one, rim=one.rim[::2], rim_places=one.rim_places[::2]) for one in plan.summaries
    ]
    before = np.concatenate(place_foreign(plan))
    after = np.concatenate(place_foreign(replace(plan, summaries=tuple(summaries))))
    is_lost = np.isnan(after).any(axis=1)
    assert 0 < is_lost.sum() < len(after)
    np.testing.assert_array_equal(after[~is_lost], before[~is_lost])
