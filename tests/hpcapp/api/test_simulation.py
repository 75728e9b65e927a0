from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hpcapp
from hpcapp.cli import _run
from hpccomponent.errors import UsageError


def test_the_scan_is_the_commands(tmp_path: Path) -> None:
    options = ["--points", "2000", "--noise", "0.002", "--outliers", "0.01", "--seed", "7"]
    output = tmp_path / "job.ply"
    assert _run(["simulate", "--shape", "torus", "-o", str(output), *options], debug=False) == 0
    cloud = hpcapp.simulate("torus", points=2000, noise=0.002, outliers=0.01, seed=7)
    hpcapp.write_points(tmp_path / "api.ply", cloud)
    assert (tmp_path / "api.ply").read_bytes() == output.read_bytes()


def test_the_whole_surface_can_be_had_exactly() -> None:
    cloud = hpcapp.simulate("sphere", points=500, views=0, normals="exact")
    assert cloud.normals is not None
    radii = np.linalg.norm(cloud.positions - cloud.positions.mean(axis=0), axis=1)
    assert np.ptp(radii) < 0.1 * radii.mean()
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1.0)


def test_wrong_values_are_named_as_python_has_them() -> None:
    with pytest.raises(UsageError, match=r"noise is 3\.0; give a number from 0 to 0\.2"):
        hpcapp.simulate("torus", noise=3.0)
    with pytest.raises(UsageError, match="knot"):
        hpcapp.simulate("donut")
