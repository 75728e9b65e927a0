"""The large cloud is on its surface, and the same however it is cut."""

from __future__ import annotations

from pathlib import Path

import big_cloud
import numpy as np
import pytest

from hpcapp.geometry.points import PointCloud
from hpcapp.io import open_points, read_points, write_points


@pytest.mark.parametrize("sweep", [False, True])
def test_points_lie_on_the_surface_and_normals_stand_on_it(
    tmp_path: Path, sweep: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(big_cloud, "ROWS_AT_ONCE", 2_000)
    big_cloud.write_cloud(tmp_path / "a.ply", 20_000, sweep)
    assert open_points(tmp_path / "a.ply").count == 20_000
    cloud = read_points(tmp_path / "a.ply")
    assert cloud.normals is not None
    lengths = np.linalg.norm(cloud.positions, axis=1)
    directions = cloud.positions / lengths[:, None]
    assert lengths == pytest.approx(big_cloud.radius(directions), abs=1e-6)
    step = np.cross(directions, np.roll(directions, 1, axis=1))
    ends = [directions + 1e-5 * sign * step for sign in (-1, 1)]
    ends = [end / np.linalg.norm(end, axis=1)[:, None] for end in ends]
    tangent = np.subtract(*(end * big_cloud.radius(end)[:, None] for end in ends))
    assert np.abs((tangent * cloud.normals).sum(axis=1)).max() < 1e-9
    assert (cloud.normals * directions).sum(axis=1).min() > 0.5
    heights = np.diff(directions[::2_000, 2])
    assert (heights > 0).all() or not sweep
    assert np.histogram(directions[:, 2], 10, (-1, 1))[0] == pytest.approx(2_000, rel=0.1)


def test_the_same_arguments_give_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(big_cloud, "ROWS_AT_ONCE", 700)
    for name in ("a", "b"):
        big_cloud.write_cloud(tmp_path / name, 2_000)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert (
        len(np.unique(read_points((tmp_path / "a").rename(tmp_path / "a.ply")).positions)) > 5_900
    )


def test_a_mesh_of_it_is_judged_by_the_formula(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(big_cloud, "ROWS_AT_ONCE", 700)
    big_cloud.write_cloud(tmp_path / "a.ply", 2_000)
    positions = read_points(tmp_path / "a.ply").positions
    positions[7] *= 1.5 / np.linalg.norm(positions[7])  # where the surface is 1.08 away at most
    write_points(tmp_path / "b.ply", PointCloud(positions))
    monkeypatch.setattr("sys.argv", ["big_cloud.py", str(tmp_path / "b.ply"), "--check"])
    big_cloud.main()
    vertices, rms, largest = big_cloud.measure_distances(tmp_path / "b.ply")
    assert vertices == 2_000
    assert 0.42 < largest < 0.58
    assert rms == pytest.approx(largest / 2_000**0.5, rel=1e-3)
    assert f"{largest:.3g} at most" in capsys.readouterr().out
