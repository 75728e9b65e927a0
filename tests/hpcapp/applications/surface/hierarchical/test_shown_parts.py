"""What a job shows of itself while it runs: its mesh part by part, and how far it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_points
from hpcapp.progress import LoadPart, Progress, ProgressObserver


class Looking(ProgressObserver):
    """Looks at parts as they come, and remembers what it is told."""

    shows_parts = True

    def __init__(self) -> None:
        self.shares: dict[str, list[float]] = {}
        self.parts: list[tuple[str, int]] = []
        self._stage = ""

    def on_begin(self, stage: str) -> None:
        """Take note."""
        self._stage = stage

    def on_advance(self, stage: str, done: int, total: int) -> None:
        """Take note."""
        self.shares.setdefault(stage, [0.0]).append(done / total)

    def on_part(self, load: LoadPart) -> None:
        """Load it at once."""
        self.parts.append((self._stage, len(load().vertices)))


@pytest.fixture
def scan(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    rng = np.random.default_rng(4)
    z, turn = rng.uniform(request.param, 1, 20_000), rng.uniform(0, 2 * np.pi, 20_000)
    wide = np.sqrt(1 - z**2)
    places = np.stack([2 * wide * np.cos(turn), wide * np.sin(turn), z], axis=1)
    normals = places / [2, 1, 1]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    write_points(tmp_path / "scan.ply", PointCloud(places, normals))
    return tmp_path / "scan.ply"


@pytest.mark.parametrize("scan", [-1.0, 0.0], ids=["closed", "open"], indirect=True)
def test_parts_come_while_the_surface_is_extracted(scan: Path) -> None:
    looking, mesh = Looking(), scan.with_name("mesh.ply")
    run_job(JobSettings(scan, str(mesh), grid=256), Progress(looking))
    watched = mesh.read_bytes()
    run_job(JobSettings(scan, str(mesh), grid=256), Progress())
    assert mesh.read_bytes() == watched
    assert len(looking.parts) >= 4
    assert {stage for stage, _ in looking.parts} == {"extract"}
    sizes = [size for _, size in looking.parts]
    assert max(sizes) < 0.5 * sum(sizes)
    for shares in looking.shares.values():
        assert shares == sorted(shares)
        assert shares[-1] == 1.0
    steps = np.diff([share for share in looking.shares["extract"] if share < 1.0])
    assert steps.max() <= 0.25
