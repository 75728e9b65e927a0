"""Points at the place of another are dropped, in memory and in a folder alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import alone

from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.hierarchical.settings import Hierarchical
from hpcapp.applications.surface.job.scan import Loaded, PointFolder
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.normals.sides import orient_cloud
from hpcapp.applications.surface.normals.viewpoint import Viewpoint
from hpcapp.applications.surface.paper.settings import Paper
from hpcapp.applications.surface.pipeline import load
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_points
from hpcapp.progress import Progress, StageClock
from hpccomponent.errors import InputError

TIMES = 5


def write_repeated(path: Path, cloud: PointCloud, points: int) -> Path:
    """Write a cloud whose first points come five times, later with other normals."""
    assert cloud.normals is not None
    again = np.tile(np.arange(points), TIMES - 1)
    turned = -cloud.normals[again]
    rows = np.random.default_rng(2).permutation(len(again))
    write_points(
        path,
        PointCloud(
            np.vstack([cloud.positions, cloud.positions[again][rows]]),
            np.vstack([cloud.normals, turned[rows]]),
        ),
    )
    return path


def load_clean(path: Path, *, clean: bool = True) -> Loaded:
    settings = JobSettings(path, "m.ply", method=Hierarchical(clean=clean))
    return load(settings, StageClock(Progress()))


def points_of(loaded: Loaded) -> tuple[bytes, bytes]:
    positions, normals = loaded.cloud.take_blocks(loaded.cloud.keys)
    return positions.tobytes(), normals.tobytes()


@pytest.mark.parametrize("repeated", [0, 1, 1500])
@pytest.mark.parametrize("rows", [500, 100_000])
@pytest.mark.parametrize("clean", [True, False])
def test_the_first_at_each_place_stays(
    tmp_path: Path, sphere_file: Path, sphere: PointCloud, repeated: int, rows: int, clean: bool
) -> None:
    path = write_repeated(tmp_path / "again.ply", sphere, repeated)
    memory = load_clean(path, clean=clean)
    assert points_of(memory) == points_of(load_clean(sphere_file, clean=clean))
    assert memory.cleaned.repeated == repeated * (TIMES - 1)
    settings = JobSettings(path, "m.ply", method=Hierarchical(clean=clean))
    there = PointFolder(tmp_path / "there", alone(rows))
    folder = load(settings, StageClock(Progress()), there)
    assert points_of(folder) == points_of(memory)
    assert folder.cleaned == memory.cleaned
    assert folder.cloud.measured.spacing == memory.cloud.measured.spacing
    assert len(folder.cloud) == len(sphere)
    kept = JobSettings(path, "m.ply", method=Hierarchical(clean=clean), resume=True)
    again = load(kept, StageClock(Progress()), there)
    assert points_of(again) == points_of(memory)
    assert again.cleaned == memory.cleaned


@pytest.mark.parametrize("method", [Hierarchical(), Paper()], ids=["hierarchical", "paper"])
def test_the_mesh_is_that_of_the_cloud_itself(
    tmp_path: Path, sphere_file: Path, sphere: PointCloud, method: Hierarchical | Paper
) -> None:
    path = write_repeated(tmp_path / "again.ply", sphere, len(sphere))
    meshes = []
    for source in (sphere_file, path):
        target = tmp_path / "m.ply"
        settings = JobSettings(source, str(target), method=method, grid=32, backend="serial")
        report = run_job(settings, Progress())
        meshes.append(target.read_bytes())
    assert report["dropped"]["duplicates"] == len(sphere) * (TIMES - 1)
    assert meshes[0] == meshes[1]


def test_too_few_places_are_refused(tmp_path: Path, sphere: PointCloud) -> None:
    some = sphere.take(np.arange(8))
    path = write_repeated(tmp_path / "a.ply", some, 8)
    settings = JobSettings(path, "m.ply", method=Hierarchical())
    with pytest.raises(InputError, match=r"a\.ply has 8 usable points"):
        load_clean(path)
    with pytest.raises(InputError, match=r"a\.ply has 8 usable points"):
        load(settings, StageClock(Progress()), PointFolder(tmp_path / "there", alone(1000)))


@pytest.mark.parametrize("method", [Hierarchical(), Paper()], ids=["hierarchical", "paper"])
def test_points_on_no_surface_are_refused_unless_they_have_normals(
    tmp_path: Path, method: Hierarchical | Paper
) -> None:
    positions = np.random.default_rng(5).random((3_000, 3))
    path = tmp_path / "a.ply"
    write_points(path, PointCloud(positions))
    settings = JobSettings(path, "m.ply", method=method)
    with pytest.raises(InputError, match="fill a volume"):
        load(settings, StageClock(Progress()))
    normals = positions - 0.5
    write_points(path, PointCloud(positions, normals / np.linalg.norm(normals, axis=1)[:, None]))
    loaded = load(settings, StageClock(Progress()))
    assert len(loaded.cloud) + loaded.cleaned.strays == 3_000
    assert loaded.cleaned.strays < 10
    with pytest.raises(InputError, match="fill a volume"):
        load(replace(settings, normals="estimate"), StageClock(Progress()))


def test_what_was_recognised_is_in_the_report(tmp_path: Path, sphere: PointCloud) -> None:
    assert sphere.normals is not None
    positions = np.vstack([sphere.positions + 7, np.zeros((40, 3))])
    normals = np.vstack([sphere.normals, sphere.normals[:40]])
    path = tmp_path / "a.ply"
    write_points(path, PointCloud(positions, (normals + 1) / 2))
    settings = JobSettings(path, str(tmp_path / "m.ply"), grid=32, backend="serial")
    report = run_job(settings, Progress())
    assert report["dropped"]["repeated"] == 40
    warned = "\n".join(report["warnings"])
    assert "origin" in warned
    assert "decoded" in warned
    assert report["watertight"]


@pytest.mark.parametrize(
    ("viewpoint", "offset", "kind", "is_told"),
    [
        ((), 0.0, "unknown", False),
        ((), 500_000.0, "above", False),
        ("below", 500_000.0, "below", True),
        (((1.0, 2.0, 3.0),), 500_000.0, "places", True),
    ],
)
def test_the_user_knows_the_sensor_best(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    viewpoint: Viewpoint,
    offset: float,
    kind: str,
    is_told: bool,
) -> None:
    ground = np.random.default_rng(0).uniform(0.0, 100.0, (3_000, 3)) * (1.0, 1.0, 0.01)
    path = tmp_path / "ground.xyz"
    np.savetxt(path, ground + np.array([offset, offset, 0.0]), fmt="%.3f")
    sensors = []

    def spy(*arguments: Any, **options: Any) -> Any:
        sensors.append(arguments[3])
        return orient_cloud(*arguments, **options)

    monkeypatch.setattr("hpcapp.applications.surface.pipeline.orient_cloud", spy)
    load(JobSettings(path, "m.ply", viewpoint=viewpoint), StageClock(Progress()))
    assert [(sensor.kind, sensor.is_told) for sensor in sensors] == [(kind, is_told)]
