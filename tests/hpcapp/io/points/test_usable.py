import numpy as np
import pytest
from spheres import make_sphere

from hpcapp.geometry.points import PointCloud
from hpcapp.geometry.validity import Dropped
from hpcapp.io.points.usable import drop_unusable
from hpccomponent.errors import InputError


def test_a_good_cloud_passes_whole() -> None:
    cloud, dropped = drop_unusable(make_sphere(40))
    assert dropped == Dropped(0, 0)
    assert (cloud.positions == make_sphere(40).positions).all()


def test_bad_points_and_normals_are_dropped_and_counted_once() -> None:
    good = make_sphere(40)
    assert good.normals is not None
    good.positions[[1, 5, 6], [0, 1, 2]] = [np.nan, np.inf, -np.inf]
    good.normals[[5, 7]] = 0.0
    good.normals[[8, 9], [0, 1]] = [np.nan, np.inf]
    colours = np.arange(120, dtype=np.uint8).reshape(40, 3)
    marked = PointCloud(good.positions, good.normals, colours, origin=np.array([7.0, 0, 0]))
    cloud, dropped = drop_unusable(marked)
    assert dropped == Dropped(non_finite_points=3, bad_normals=3)
    assert dropped.total == 6
    assert len(cloud) == 34
    assert cloud.colours is not None
    assert cloud.colours[:, 0].tolist() == [3 * i for i in range(40) if i not in (1, 5, 6, 7, 8, 9)]
    assert cloud.origin[0] == 7


@pytest.mark.parametrize("length", [1e-300, 1e-160, 0.5, 2.0, 1e200, 1e308])
def test_normals_of_any_length_become_units(length: float) -> None:
    given = make_sphere(40)
    assert given.normals is not None
    cloud, _ = drop_unusable(PointCloud(given.positions, given.normals * length))
    assert cloud.normals is not None
    assert np.abs(cloud.normals - given.normals).max() < 1e-12


@pytest.mark.parametrize(
    ("cloud", "said"),
    [
        (PointCloud(np.empty((0, 3)), np.empty((0, 3))), "holds no points"),
        (make_sphere(1), "has 1 usable points; a surface needs at least 10"),
        (make_sphere(9), "has 9 usable points"),
        (
            PointCloud(make_sphere(40).positions, np.zeros((40, 3))),
            "no usable points after .* 40 with a",
        ),
        (PointCloud(np.full((40, 3), np.nan), np.ones((40, 3))), "no usable points .* 40 with NaN"),
        (PointCloud(np.full((40, 3), 2.5), np.ones((40, 3))), "all 40 points lie in one place"),
        (PointCloud(np.zeros((40, 3)), np.ones((40, 3))), "one place"),
    ],
)
def test_hopeless_clouds_are_refused_by_name(cloud: PointCloud, said: str) -> None:
    with pytest.raises(InputError, match=f"^scan.ply.*{said}"):
        drop_unusable(cloud, "scan.ply")


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
@pytest.mark.parametrize("direction", [[1.0, 0, 0], [1.0, -2.0, 0.3]])
def test_points_on_one_line_are_refused(scale: float, direction: list[float]) -> None:
    along = np.linspace(-1, 1, 50)[:, None] * np.array(direction)
    rounded = along.astype(np.float32).astype(np.float64) * scale
    with pytest.raises(InputError, match="lie on one line"):
        drop_unusable(PointCloud(rounded, np.ones((50, 3))))


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_coplanar_points_and_narrow_strips_pass(scale: float) -> None:
    flat = make_sphere(40, scale).positions * np.array([1.0, 1e-3, 0.0])
    cloud, _ = drop_unusable(PointCloud(flat, np.ones((40, 3))))
    assert len(cloud) == 40
