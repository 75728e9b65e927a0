from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from hpcapp.applications.points.command import info
from hpcapp.applications.points.place_colours import colour_by_noise, colour_by_spacing
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_points
from hpccomponent.errors import UsageError


def two_sheets() -> PointCloud:
    """Points 0.01 apart where x is below 1, and 0.1 apart above; one of them is nowhere."""
    places = []
    for low, high, spacing in ((0.0, 1.0, 0.01), (1.0, 5.0, 0.1)):
        x, y = np.meshgrid(np.arange(low, high, spacing), np.arange(0.0, 2.0, spacing))
        places.append(np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1))
    return PointCloud(np.concatenate([*places, [[np.nan, 0.0, 0.0]]]))


def test_dense_points_are_bluer_than_sparse_ones() -> None:
    shown = colour_by_spacing(two_sheets())
    assert len(shown) == len(two_sheets()) - 1
    assert shown.colours is not None
    dense = shown.positions[:, 0] < 0.9
    sparse = shown.positions[:, 0] > 1.5
    of_dense, of_sparse = (shown.colours[some].astype(int).mean(axis=0) for some in (dense, sparse))
    assert of_sparse[1] > of_dense[1] + 60  # green, on the way to yellow
    assert of_sparse[2] < of_dense[2] + 60


def test_good_points_are_bluer_than_bad_ones() -> None:
    random = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(0.0, 2.0, 0.01), np.arange(0.0, 1.0, 0.01))
    heights = random.normal(scale=np.where(x < 1.0, 0.001, 0.006))
    shown = colour_by_noise(PointCloud(np.stack([x, y, heights], axis=-1).reshape(-1, 3)))
    assert shown.colours is not None
    good, bad = shown.positions[:, 0] < 0.9, shown.positions[:, 0] > 1.1
    of_good, of_bad = (shown.colours[some].astype(int).mean(axis=0) for some in (good, bad))
    assert of_bad[1] > of_good[1] + 60  # green, on the way to yellow
    assert of_bad[2] < of_good[2] + 60


def test_the_picture_is_drawn_by_spacing_if_asked(tmp_path: Path) -> None:
    cloud = two_sheets().take(np.arange(len(two_sheets()) - 1))
    write_points(tmp_path / "scan.ply", cloud)
    pictures = []
    for words in ([], ["--by-spacing"], ["--by-noise"]):
        given = [str(tmp_path / "scan.ply"), "--png", str(tmp_path / "a.png"), *words]
        done = CliRunner().invoke(info, given, catch_exceptions=False)
        assert done.exit_code == 0
        pictures.append((tmp_path / "a.png").read_bytes())
    assert len(set(pictures)) == 3


@pytest.mark.parametrize("word", ["--by-spacing", "--by-noise"])
def test_without_a_picture_there_is_nothing_to_colour(tmp_path: Path, word: str) -> None:
    write_points(tmp_path / "scan.ply", PointCloud(np.eye(3)))
    with pytest.raises(UsageError, match="--png"):
        CliRunner().invoke(info, [str(tmp_path / "scan.ply"), word], catch_exceptions=False)
