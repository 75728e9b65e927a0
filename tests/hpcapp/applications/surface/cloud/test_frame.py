"""The lattices of a cloud, laid by its own points or by those of an earlier job."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.cloud.arranged import CloudMeasures, arrange_cloud
from hpcapp.applications.surface.cloud.frame import Frame, shift_points
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.geometry.points import FloatArray, PointCloud


def cloud(points: int = 500, side: float = 1.0) -> PointCloud:
    positions, normals = np.random.default_rng(3).uniform(0.0, side, (2, points, 3))
    return PointCloud(positions, normals)


def measures() -> CloudMeasures:
    return CloudMeasures(LocalScale.uniform(0.1), cloud(10))


def fill(frame: Frame, points: PointCloud) -> FloatArray:
    """Go through a frame as a job does; return the corners of the cloud's box."""
    frame.place(points.origin)
    arranged = arrange_cloud(points, frame.arrange)
    frame.space("read", lambda: 0.25)
    frame.measure(measures)
    return np.stack([arranged.low, arranged.high])


def test_a_frame_of_its_own_is_the_clouds_box() -> None:
    own = arrange_cloud(cloud())
    framed = arrange_cloud(cloud(), Frame().arrange)
    assert framed.arrangement.box is None
    np.testing.assert_array_equal([framed.low, framed.high], [own.low, own.high])


def test_what_is_known_is_taken_while_the_points_lie_in_its_box() -> None:
    first = Frame(keeps=True)
    box = fill(first, cloud())
    again = Frame(first.tell(), keeps=True)
    np.testing.assert_array_equal(fill(again, cloud(points=40)), box)
    assert again.is_known
    assert again.space("thinned", lambda: 7.0) == 0.25  # the stage before tells it
    assert again.measure(measures).sample.positions.tobytes() == cloud(10).positions.tobytes()


def test_points_beyond_the_box_make_another_frame() -> None:
    first = Frame(keeps=True)
    fill(first, cloud())
    again = Frame(first.tell(), keeps=True)
    assert np.ptp(fill(again, cloud(side=2.0))) > 2.0
    assert not again.is_known
    assert again.space("thinned", lambda: 7.0) == 7.0


def test_a_cloud_keeps_the_box_of_its_frame_when_points_are_dropped() -> None:
    arranged = arrange_cloud(cloud(), Frame(keeps=True).arrange)
    kept = arranged.select(arranged.points.positions[:, 0] < 0.5)
    np.testing.assert_array_equal([kept.low, kept.high], [arranged.low, arranged.high])


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (5_400_000.0, 450_000.0, 12.0)])
def test_points_are_moved_to_another_origin_without_rounding(origin: tuple[float, ...]) -> None:
    places = np.floor(cloud().positions * 2**20) / 2**20
    moved = shift_points(PointCloud(places, origin=np.array(origin)), np.array(origin) + 3.0)
    np.testing.assert_array_equal(moved.positions + 3.0, places)
    np.testing.assert_array_equal(moved.origin, np.array(origin) + 3.0)
