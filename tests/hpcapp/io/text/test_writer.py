from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.formats import read_points
from hpcapp.io.text.writer import write_text_points


@pytest.mark.parametrize("with_normals", [True, False])
@pytest.mark.parametrize("with_colors", [True, False])
def test_what_is_written_comes_back(
    tmp_path: Path, cloud: PointCloud, with_normals: bool, with_colors: bool
) -> None:
    some = PointCloud(
        cloud.positions / 3,
        cloud.normals if with_normals else None,
        cloud.colours if with_colors else None,
    )
    write_text_points(tmp_path / "a.xyz", some)
    again = read_points(tmp_path / "a.xyz")
    assert (again.positions == some.positions).all()
    np.testing.assert_array_equal(again.normals, some.normals)
    np.testing.assert_array_equal(again.colours, some.colours)


@pytest.mark.parametrize("intensity", [np.linspace(0.0, 1.0, 60), np.arange(60) - 900.0])
def test_the_column_before_the_colours_is_the_intensity(
    tmp_path: Path, intensity: FloatArray
) -> None:
    rng = np.random.default_rng(4)
    colours = rng.integers(0, 256, (60, 3)).astype(np.uint8)
    cloud = PointCloud(rng.normal(size=(60, 3)), None, colours, {"intensity": intensity})
    write_text_points(tmp_path / "a.xyz", cloud)
    again = read_points(tmp_path / "a.xyz")
    np.testing.assert_array_equal(again.attributes["intensity"], intensity)
    np.testing.assert_array_equal(again.colours, colours)


def test_georeferenced_millimetres_survive(tmp_path: Path) -> None:
    utm = np.random.default_rng(3).uniform(0, 50, (100, 3)).round(3) + 5.4e6
    write_text_points(tmp_path / "a.xyz", PointCloud(utm - 5.4e6, origin=np.full(3, 5.4e6)))
    cloud = read_points(tmp_path / "a.xyz")
    assert np.abs(cloud.positions).max() < 50
    assert np.abs(cloud.positions + cloud.origin - utm).max() < 1e-6
