"""Jobs with --pieces and --smallest: one mesh, wherever the points and the parts are."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from little_memory import leave_little_memory

from hpcapp.api.reconstruction import reconstruct
from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.geometry.points import PointCloud
from hpcapp.io import read_mesh, write_points
from hpcapp.progress import Progress
from hpccomponent.errors import UsageError

BALLS = ((0.0, 1.0), (2.2, 0.5), (3.6, 0.4))  # x of the middle, radius


def make_balls(balls: tuple[tuple[float, float], ...] = BALLS) -> PointCloud:
    """Balls in a row, scanned with one spacing."""
    random, positions, normals = np.random.default_rng(3), [], []
    for x, radius in balls:
        directions = random.normal(size=(int(9000 * radius**2), 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        positions.append(radius * directions + np.array([x, 0.0, 0.0]))
        normals.append(directions)
    return PointCloud(np.concatenate(positions), np.concatenate(normals))


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    path = tmp_path / "scan.ply"
    write_points(path, make_balls())
    return path


@pytest.mark.parametrize(("pieces", "smallest"), [(2, None), (None, 2.6)])
def test_the_same_pieces_stay_in_memory_and_in_tiles(
    scan: Path, monkeypatch: pytest.MonkeyPatch, pieces: int | None, smallest: float | None
) -> None:
    outputs = [scan.with_name(name) for name in ("memory.ply", "disk.ply")]
    settings = JobSettings(scan, str(outputs[0]), grid=64, pieces=pieces, smallest=smallest)
    report = run_job(settings, Progress())
    assert (report["tiles"], report["components"], report["pieces_dropped"]) == (1, 2, 1)
    assert report["watertight"]
    leave_little_memory(monkeypatch, 2000)
    tiled = replace(settings, output=str(outputs[1]), backend="threads", workers=2)
    report = run_job(tiled, Progress())
    assert report["tiles"] > 1
    assert report["components"] == 2
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    assert read_mesh(outputs[0]).vertices[:, 0].max() < 2.8


def test_workers_write_the_same_pieces(scan: Path) -> None:
    outputs = [scan.with_name(name) for name in ("here.ply", "workers.ply")]
    run_job(JobSettings(scan, str(outputs[0]), grid=64, pieces=1, backend="serial"), Progress())
    settings = JobSettings(
        scan, str(outputs[1]), grid=64, pieces=1, backend="zmq", workers=2, max_memory=3e8,
        temp_dir=str(scan.with_name("points")),
    )  # fmt: skip
    report = run_job(settings, Progress())
    assert report["components"] == 1
    assert outputs[0].read_bytes() == outputs[1].read_bytes()


def test_from_python_too() -> None:
    mesh = reconstruct(make_balls(), grid=64, pieces=1, executor="serial")
    assert mesh.volume == pytest.approx(4.0 / 3.0 * np.pi, rel=0.01)
    with pytest.raises(UsageError, match="as large as 100: the largest has 12"):
        reconstruct(make_balls(), grid=64, smallest=100.0, executor="serial")
    with pytest.raises(UsageError, match="pieces is 0"):
        reconstruct(make_balls(), pieces=0)


@pytest.mark.parametrize(("side", "is_small"), [(0.24, True), (0.75, False)])
def test_a_small_piece_of_a_view_is_named_with_what_drops_it(
    caplog: pytest.LogCaptureFixture, side: float, is_small: bool
) -> None:
    """A plate of 6 by 6, and a chip above it, of about 0.0016 and of 0.016 of its area."""
    caplog.set_level(logging.INFO, "hpcapp")
    random = np.random.default_rng(5)
    plate = random.uniform(-3.0, 3.0, (90_000, 3)) * (1.0, 1.0, 0.0)
    chip = random.uniform(-0.5 * side, 0.5 * side, (int(2_500 * side**2), 3)) * (1.0, 1.0, 0.0)
    positions = np.concatenate([plate, chip + np.array([0.0, 0.0, 0.5])])
    cloud = PointCloud(positions, np.tile([0.0, 0.0, 1.0], (len(positions), 1)))
    mesh = reconstruct(cloud, close="no", trim="0.06", grid=160, executor="serial")
    lines = [record.message for record in caplog.records if "of 2 pieces" in record.message]
    assert mesh.facts["components"] == 2
    assert mesh.facts["small_pieces"] == int(is_small)
    said = "1 of 2 pieces is small, 0.2 % of the area: pieces=1 drops it"
    assert lines == ([said] if is_small else [])
