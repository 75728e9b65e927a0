"""Colours and numbers of the points arrive on the mesh, the same bits wherever it was made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from little_memory import leave_little_memory
from numpy.typing import NDArray

import hpcapp
from hpcapp.applications.surface.attributes.choice import parse_attributes
from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.normals.orientation import SURE
from hpcapp.applications.surface.stitching import surface
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import write_points
from hpcapp.progress import Progress
from hpccomponent.errors import InputError, JobError, UsageError

SILENT = Progress()
FAR = np.array([4.0e5, 5.4e6, 0.0])
CENTRE = np.array([3.0, -1.0, 2.0])


def paint(units: FloatArray) -> PointCloud:
    """A sphere of radius 2 whose columns are known everywhere."""
    return PointCloud(
        CENTRE + 2.0 * units,
        units,
        np.rint(127.5 * (1.0 + units)).astype(np.uint8),
        {
            "intensity": np.rint(30_000 + 20_000 * units[:, 0]).astype(np.uint16),
            "classification": np.where(units[:, 2] > 0, 5, 2).astype(np.uint8),
            "row": np.arange(len(units), dtype=np.int32),
        },
    )


@pytest.fixture(scope="module")
def cloud() -> PointCloud:
    arms = np.random.default_rng(4).normal(size=(20_000, 3))
    return paint(arms / np.linalg.norm(arms, axis=1, keepdims=True))


def read_vertices(path: Path) -> NDArray[Any]:
    """Return the vertices of a binary PLY by the names of their properties."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = [line.split() for line in head.decode().splitlines()]
    count = next(int(line[2]) for line in lines if line[:2] == ["element", "vertex"])
    kinds = {"float": "<f4", "double": "<f8", "uchar": "u1", "ushort": "<u2"}
    properties = [line for line in lines if line[0] == "property" and line[1] != "list"]
    return np.frombuffer(body, [(name, kinds[kind]) for _, kind, name in properties], count)


def test_a_painted_sphere_comes_back_painted(cloud: PointCloud) -> None:
    mesh = hpcapp.reconstruct(cloud, grid=64, attributes="auto,normals,support")
    units = (mesh.vertices - CENTRE) / 2.0
    truth = paint(units / np.linalg.norm(units, axis=1, keepdims=True))
    assert mesh.colours is not None
    assert truth.colours is not None
    assert mesh.normals is not None
    assert truth.normals is not None
    assert mesh.colours.dtype == np.uint8
    assert np.abs(mesh.colours.astype(int) - truth.colours).max() <= 6
    assert list(mesh.attributes) == ["intensity", "classification", "support"]
    error = mesh.attributes["intensity"].astype(float) - truth.attributes["intensity"]
    assert np.abs(error).max() < 1000
    is_inner = np.abs(units[:, 2]) > 0.05
    classes = mesh.attributes["classification"]
    assert (classes == truth.attributes["classification"])[is_inner].all()
    assert (mesh.normals * truth.normals).sum(axis=1).min() > 0.99
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, rtol=1e-12)
    assert 0.0 < np.median(mesh.attributes["support"]) < 1.0
    assert mesh.attributes["support"].max() < 3.0


def test_support_tells_where_the_scan_has_a_hole(cloud: PointCloud) -> None:
    has_hole = cloud.take(cloud.positions[:, 0] < CENTRE[0] + 1.7)
    mesh = hpcapp.reconstruct(has_hole, grid=64, attributes="support")
    assert mesh.colours is None
    assert mesh.normals is None
    support = mesh.attributes["support"]
    is_seen = mesh.vertices[:, 0] < CENTRE[0] + 1.6
    assert support[is_seen].max() < 3.0
    assert support[~is_seen].max() > 8.0


def test_without_columns_the_mesh_is_the_plain_one(cloud: PointCloud, tmp_path: Path) -> None:
    write_points(tmp_path / "plain.ply", PointCloud(cloud.positions, cloud.normals))
    write_points(
        tmp_path / "painted.ply", PointCloud(cloud.positions, cloud.normals, cloud.colours)
    )
    meshes = []
    for name, chosen, names in (
        ("plain", "auto", []),
        ("painted", "none", []),
        ("painted", "auto", ["colours"]),
    ):
        output = tmp_path / f"{name}-{chosen}.ply"
        settings = JobSettings(
            tmp_path / f"{name}.ply",
            str(output),
            grid=48,
            attributes=parse_attributes(chosen),
        )
        report = run_job(settings, SILENT)
        assert report["attributes"] == names
        meshes.append(output)
    assert meshes[0].read_bytes() == meshes[1].read_bytes()
    plain, painted = read_vertices(meshes[0]), read_vertices(meshes[2])
    assert plain.dtype.names == ("x", "y", "z")
    assert painted.dtype.names == ("x", "y", "z", "red", "green", "blue")
    for axis in "xyz":
        np.testing.assert_array_equal(plain[axis], painted[axis])


def test_the_paper_method_carries_too(cloud: PointCloud) -> None:
    mesh = hpcapp.reconstruct(cloud, grid=32, method="paper", attributes="intensity,support")
    units = (mesh.vertices - CENTRE) / np.linalg.norm(mesh.vertices - CENTRE, axis=1, keepdims=True)
    error = mesh.attributes["intensity"] - (30_000 + 20_000 * units[:, 0])
    assert np.abs(error).max() < 2000
    assert mesh.attributes["support"].dtype == np.float32


def test_a_cloud_from_a_file_gives_the_mesh_of_the_command(
    cloud: PointCloud, tmp_path: Path
) -> None:
    far = PointCloud(cloud.positions + FAR, cloud.normals, cloud.colours)
    write_points(tmp_path / "far.ply", far)
    read = hpcapp.read_points(tmp_path / "far.ply")
    assert read.origin.any()
    hpcapp.reconstruct(read, grid=48).save(tmp_path / "api.ply")
    run_job(JobSettings(tmp_path / "far.ply", str(tmp_path / "job.ply"), grid=48), SILENT)
    assert (tmp_path / "api.ply").read_bytes() == (tmp_path / "job.ply").read_bytes()


def test_estimated_normals_carry_their_confidence_only_where_it_is_named(
    cloud: PointCloud,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    assert cloud.colours is not None
    bare = tmp_path / "bare.ply"
    write_points(bare, PointCloud(cloud.positions[:3000], None, cloud.colours[:3000]))

    def run(name: str, attributes: str, points: Path = bare) -> tuple[list[str], str]:
        caplog.clear()
        choice = parse_attributes(attributes)
        settings = JobSettings(points, str(tmp_path / name), grid=32, attributes=choice)
        return run_job(settings, SILENT)["attributes"], caplog.text

    assert run("memory.ply", "auto")[0] == ["colours"]
    names, text = run("named.ply", "auto,confidence")
    assert names == ["colours", "confidence"]
    assert "left out" not in text
    confidence = read_vertices(tmp_path / "named.ply")["confidence"]
    assert SURE < np.median(confidence) <= 1.0
    given = tmp_path / "given.ply"
    write_points(given, cloud)
    assert "attributes='confidence': left out" in run("given-mesh.ply", "confidence", given)[1]
    leave_little_memory(monkeypatch)
    for name in ("auto,confidence", "confidence,support"):
        run("memory.ply", name)
        with monkeypatch.context() as small:
            leave_little_memory(small)
            assert "confidence" in run("folder.ply", name)[0]
        assert (tmp_path / "folder.ply").read_bytes() == (tmp_path / "memory.ply").read_bytes()


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"colours": np.zeros((5, 3), np.uint8)}, r"colours has the shape \(5, 3\)"),
        ({"colours": np.full((20_000, 3), 0.5)}, "colours holds float64 beyond whole numbers"),
        ({"colours": np.full((20_000, 3), 256)}, "colours holds int64 beyond whole numbers"),
        ({"attributes": {"a": np.zeros(7)}}, "the attribute 'a' holds float64 of the shape"),
        ({"attributes": {"b": ["x"] * 20_000}}, "the attribute 'b' holds <U1"),
    ],
)
def test_a_wrong_column_is_named(cloud: PointCloud, columns: dict[str, Any], words: str) -> None:
    wrong = PointCloud(cloud.positions, cloud.normals, **columns)
    with pytest.raises(InputError, match=words):
        hpcapp.reconstruct(wrong, grid=32)


def test_normals_beside_a_cloud_and_unknown_columns_are_refused(cloud: PointCloud) -> None:
    with pytest.raises(UsageError, match="normals stands beside a cloud"):
        hpcapp.reconstruct(cloud, cloud.normals)
    with pytest.raises(UsageError, match="the cloud has colours, intensity, classification, row"):
        hpcapp.reconstruct(cloud, attributes="depth")


@pytest.fixture
def painted_file(cloud: PointCloud, tmp_path: Path) -> Path:
    """The sphere in a file, with a hole, some outliers, and points twice in other colours."""
    rng = np.random.default_rng(1)
    rows = cloud.take(np.flatnonzero(cloud.positions[:, 1] < CENTRE[1] + 1.8))
    rows.positions[::2000] += rng.uniform(0.5, 2.0, rows.positions[::2000].shape)
    rows = rows.take(rng.permutation(np.append(np.arange(len(rows)), np.arange(5000))))
    assert rows.colours is not None
    rows.colours[::7] = 255 - rows.colours[::7]
    path = tmp_path / "painted.ply"
    write_points(path, rows)
    return path


@pytest.mark.parametrize("name", ["mesh.ply", "mesh.obj"])
@pytest.mark.parametrize(
    ("backend", "workers"), [("serial", None), pytest.param("zmq", 3, marks=pytest.mark.slow)]
)
def test_tiles_and_workers_give_the_bytes_of_memory(
    painted_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    backend: str,
    workers: int | None,
    name: str,
) -> None:
    chosen = parse_attributes("auto,normals,support")
    whole, tiled = tmp_path / f"whole-{name}", tmp_path / f"tiled-{name}"
    run_job(JobSettings(painted_file, str(whole), grid=64, attributes=chosen), SILENT)
    leave_little_memory(monkeypatch, 6_000)
    settings = JobSettings(
        painted_file,
        str(tiled),
        grid=64,
        attributes=chosen,
        temp_dir=str(tmp_path / "temp"),
        backend=backend,
        workers=workers,
    )
    report = run_job(settings, SILENT)
    assert report["tiles"] > 1
    assert report["attributes"] == [
        "normals", "colours", "intensity", "classification", "support",
    ]  # fmt: skip
    assert report["dropped"]["duplicates"] == 5000
    assert tiled.read_bytes() == whole.read_bytes()
    assert not list((tmp_path / "temp").iterdir())


def test_a_column_that_is_not_there_is_refused_before_the_work(
    painted_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = parse_attributes("auto,depth")
    settings = JobSettings(painted_file, str(tmp_path / "m.ply"), attributes=chosen)
    for _ in range(2):
        with pytest.raises(
            UsageError, match=r"painted.ply has colours, intensity, classification, row;"
        ):
            run_job(settings, SILENT)
        leave_little_memory(monkeypatch)


def test_tiles_carry_what_needs_no_other_tile(
    painted_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    leave_little_memory(monkeypatch, 6_000)
    chosen = parse_attributes("auto,normals")
    settings = JobSettings(painted_file, str(tmp_path / "m.tiles"), grid=48, attributes=chosen)
    run_job(settings, SILENT)
    tiles = [read_vertices(path) for path in sorted((tmp_path / "m.tiles").iterdir())]
    assert len(tiles) > 1
    seen: dict[bytes, bytes] = {}
    for tile in tiles:
        assert tile.dtype.names is not None
        assert tile.dtype.names[3:] == ("red", "green", "blue", "intensity", "classification")
        for row in tile:
            place, carried = row.tobytes()[:12], row.tobytes()[12:]
            assert seen.setdefault(place, carried) == carried


def test_a_job_that_is_resumed_carries_the_same(
    painted_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, again = tmp_path / "whole.ply", tmp_path / "again.ply"
    settings = JobSettings(
        painted_file,
        str(whole),
        grid=48,
        normals="estimate",
        attributes=parse_attributes("auto,confidence"),
    )
    run_job(settings, SILENT)
    leave_little_memory(monkeypatch, 6_000)
    settings = replace(settings, output=str(again), temp_dir=str(tmp_path / "temp"), resume=True)

    def fail(*_: object) -> None:
        raise JobError("stopped", "go on")

    with monkeypatch.context() as broken:
        broken.setattr(surface, "write_mesh", fail)
        with pytest.raises(JobError, match="stopped"):
            run_job(settings, SILENT)
    assert list((tmp_path / "temp").rglob("confidence.*"))
    run_job(settings, SILENT)
    assert again.read_bytes() == whole.read_bytes()
    assert not list((tmp_path / "temp").iterdir())
