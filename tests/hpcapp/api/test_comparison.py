from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hpcapp
from hpccomponent.errors import InputError, UsageError

FAR = np.array([5_400_000.0, 400_000.0, 100.0])
SQUARE = np.array([[0.0, 0, 0], [4, 0, 0], [4, 3, 0], [0, 3, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def lift(height: float, shift: np.ndarray | float = 0.0) -> hpcapp.Mesh:
    return hpcapp.Mesh(SQUARE + np.array([0.0, 0.0, height]) + shift, FACES)


@pytest.mark.parametrize("shift", [0.0, FAR])
def test_distances_are_lengths_of_the_input(shift: np.ndarray | float) -> None:
    result = hpcapp.compare(lift(0.5, shift), lift(0.0, shift), samples=500)
    assert result.completeness == pytest.approx(0.5)
    assert result.mean == pytest.approx(0.5)
    assert result.hausdorff == pytest.approx(0.5)
    assert result.diagonal == pytest.approx(5.0)
    assert np.isnan(result.accuracy)  # the truth is open
    assert result.to_json()["completeness"] == pytest.approx(10.0)
    assert repr(result).startswith("Comparison(mean 0.5 (10 % of the diagonal), rms 0.5,")


def test_files_and_meshes_give_one_result(tmp_path: Path) -> None:
    mesh, truth = lift(0.25), lift(0.0)
    mesh.save(tmp_path / "mesh.ply")
    truth.save(tmp_path / "truth.ply")
    named = hpcapp.compare(str(tmp_path / "mesh.ply"), tmp_path / "truth.ply", samples=300)
    assert named.to_json() == hpcapp.compare(mesh, truth, samples=300).to_json()


@pytest.mark.parametrize("shift", [0.0, FAR])
def test_points_are_a_truth_too(shift: np.ndarray | float) -> None:
    points = np.random.default_rng(0).random((400, 3)) * [4, 3, 0] + shift
    for truth in (points, hpcapp.PointCloud(points - shift, origin=np.zeros(3) + shift)):
        result = hpcapp.compare(lift(0.5, shift), truth, samples=400)
        assert result.completeness == pytest.approx(0.5)


def test_a_shape_is_named() -> None:
    mesh = hpcapp.reconstruct(hpcapp.simulate("torus", points=4000), grid=48)
    result = hpcapp.compare(mesh, "shape:torus", samples=1000)
    assert result.is_watertight
    assert 0.0 < result.mean < 0.005 * result.diagonal
    assert set(result.f_scores) == {"0.02", "0.1", "0.5"}


def test_what_cannot_be_compared_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the mesh: holds no faces"):
        hpcapp.compare(hpcapp.Mesh(SQUARE, FACES[:0]), lift(0.0))
    with pytest.raises(InputError, match="truth: all 10 points lie in one place"):
        hpcapp.compare(lift(0.0), np.ones((10, 3)))
    with pytest.raises(InputError, match=r"none\.ply"):
        hpcapp.compare(tmp_path / "none.ply", lift(0.0))
    with pytest.raises(UsageError, match="samples is 3; give 100 or more"):
        hpcapp.compare(lift(0.0), lift(0.0), samples=3)
    with pytest.raises(UsageError, match="thresholds"):
        hpcapp.compare(lift(0.0), lift(0.0), thresholds=[0.0])
