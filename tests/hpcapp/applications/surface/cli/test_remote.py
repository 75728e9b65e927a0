"""What travels to a cluster, and what is found out before."""

from __future__ import annotations

import gzip
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from hpcapp.applications.surface.cli import remote
from hpcapp.applications.surface.cli.command import reconstruct
from hpcapp.applications.surface.cli.remote_check import check_job
from hpcapp.applications.surface.normals.viewpoint import parse_viewpoint
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io import find_mesh_crs, read_mesh, read_points, write_mesh, write_points
from hpcapp.parts.crop import make_crop
from hpccomponent.errors import InputError, UsageError


class Cluster:
    """Takes a job in a cluster's stead."""

    def __init__(self) -> None:
        self.suffix = ""
        self.points = PointCloud(np.empty((0, 3)))
        self.options: list[str] = []
        self.typed: list[str] = []

    def run(
        self, path: Path, verb: str, points: Path, target: Path, *words: Sequence[str]
    ) -> dict[str, object]:
        assert verb == "reconstruct"
        self.options, self.typed = map(list, words)
        self.suffix, self.points = points.suffix, read_points(points)
        return {"summary": f"{target}: made on {path}"}


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Cluster:
    made = Cluster()
    monkeypatch.setattr(remote, "load_cluster_function", lambda name: made.run)
    return made


@pytest.fixture
def mesh_file(tmp_path: Path) -> Path:
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    write_mesh(tmp_path / "part.stl", Mesh(corners, faces))
    assert len(read_mesh(tmp_path / "part.stl").faces) == 4
    return tmp_path / "part.stl"


def submit(folder: Path, *words: str | Path, output: str = "m.ply") -> None:
    arguments = [*map(str, words), "-o", str(folder / output), "--cluster", "cluster.yaml"]
    done = CliRunner().invoke(reconstruct, arguments, catch_exceptions=False)
    assert done.exit_code == 0


@pytest.mark.parametrize("suffix", [".laz", ".e57"])
@pytest.mark.parametrize("is_packed", [False, True])
def test_what_the_head_may_have_no_library_for_travels_as_ply(
    tmp_path: Path, sphere: PointCloud, cluster: Cluster, suffix: str, is_packed: bool
) -> None:
    path = tmp_path / f"scan{suffix}"
    write_points(path, sphere)
    if is_packed:
        packed = path.with_name(f"{path.name}.gz")
        packed.write_bytes(gzip.compress(path.read_bytes()))
        path = packed
    submit(tmp_path, path)
    assert cluster.suffix == ".ply"
    assert np.abs(cluster.points.positions - sphere.positions).max() < 1e-6
    assert cluster.points.normals is not None
    assert np.abs(cluster.points.normals - np.asarray(sphere.normals)).max() < 1e-6


def test_several_files_travel_as_one(
    tmp_path: Path, sphere: PointCloud, sphere_file: Path, cluster: Cluster
) -> None:
    write_points(tmp_path / "other.xyz", PointCloud(sphere.positions + 3.0, sphere.normals))
    submit(tmp_path, sphere_file, tmp_path / "oth*.xyz", "--grid", "32")
    assert len(cluster.points) == 2 * len(sphere)
    assert cluster.options == ["--grid", "32"]


def test_other_files_travel_as_they_are(
    tmp_path: Path, sphere: PointCloud, cluster: Cluster
) -> None:
    write_points(tmp_path / "scan.las", sphere)
    submit(tmp_path, tmp_path / "scan.las")
    assert cluster.suffix == ".las"


def test_a_mesh_is_sampled_before_it_travels(
    tmp_path: Path, mesh_file: Path, cluster: Cluster
) -> None:
    submit(tmp_path, mesh_file, "--sample", "500")
    assert len(cluster.points) == 500
    assert cluster.options == []


def test_options_of_points_without_normals_travel(
    tmp_path: Path, sphere_file: Path, cluster: Cluster
) -> None:
    options = ["--normals", "estimate", "--viewpoint", "-1.5,0,1e-9", "--viewpoint", "3,4,5"]
    submit(tmp_path, sphere_file, *options, "--attributes", "none", "--no-clean")
    ctx = reconstruct.make_context("reconstruct", ["in.ply", "-o", "m.ply", *cluster.options])
    assert parse_viewpoint(ctx.params["viewpoint"]) == ((-1.5, 0.0, 1e-9), (3.0, 4.0, 5.0))
    assert ctx.params["normals"] == "estimate"
    assert ctx.params["attributes"] == "none"
    assert ctx.params["clean"] is False


def test_the_places_of_trajectories_and_cameras_travel(
    tmp_path: Path, sphere_file: Path, cluster: Cluster
) -> None:
    flight = tmp_path / "flight.csv"
    flight.write_text("time,x,y,z\n10,1,2,3\n11,4,5,6\n")
    submit(tmp_path, sphere_file, "--viewpoint", str(flight))
    places = ["--viewpoint", "1.0,2.0,3.0@10.0", "--viewpoint", "4.0,5.0,6.0@11.0"]
    assert cluster.options == places
    here = (tmp_path / "cluster.yaml", sphere_file, tmp_path / "m.ply")
    assert check_job(*here, ["--viewpoint", str(flight)]) == places
    frames = tmp_path / "transforms.json"
    frames.write_text(
        '{"frames": [{"transform_matrix": [[1, 0, 0, 7], [0, 1, 0, 8], [0, 0, 1, 9]]}]}'
    )
    camera = ["--viewpoint", "7.0,8.0,9.0,-0.0,-0.0,-1.0"]
    assert check_job(*here, ["--viewpoint", str(frames)]) == camera
    assert check_job(*here, ["--viewpoint=above", "--no-clean"]) == [
        "--no-clean", "--viewpoint", "above",
    ]  # fmt: skip


def test_polygons_travel_as_text(tmp_path: Path, sphere_file: Path, cluster: Cluster) -> None:
    yard = tmp_path / "yard.wkt"
    yard.write_text("POLYGON ((0 0, 1 0, 1.25 1, 0 0))")
    submit(tmp_path, sphere_file, "--polygon", str(yard))
    assert cluster.options[0] == "--polygon"
    assert make_crop(polygon=cluster.options[1]) == make_crop(polygon=yard)


def test_points_that_will_not_do_are_refused_before_anything_travels(
    tmp_path: Path, cluster: Cluster
) -> None:
    (tmp_path / "bad.ply.gz").write_bytes(gzip.compress(b"ply\nformat"))
    with pytest.raises(InputError, match=r"bad\.ply\.gz"):
        submit(tmp_path, tmp_path / "bad.ply.gz")
    assert not len(cluster.points)


def test_a_job_is_checked_with_its_options(
    tmp_path: Path, sphere_file: Path, mesh_file: Path
) -> None:
    def check(points: Path, *options: str) -> None:
        check_job(tmp_path / "cluster.yaml", points, tmp_path / "m.ply", options)

    packed = tmp_path / "sphere.ply.gz"
    packed.write_bytes(gzip.compress(sphere_file.read_bytes()))
    check(sphere_file, "--normals", "estimate", "--viewpoint", "0,0,9")
    check(packed)
    check(sphere_file, "--details")
    check(mesh_file, "--sample", "500")
    with pytest.raises(UsageError, match="one file of points; join several"):
        check(sphere_file, str(packed))
    with pytest.raises(UsageError, match="--json is not for the job"):
        check(sphere_file, "--json")


def test_the_page_of_a_fetched_mesh_is_made_here(
    tmp_path: Path, sphere_file: Path, cluster: Cluster
) -> None:
    def run(path: Path, verb: str, points: Path, target: Path, *words: Sequence[str]) -> object:
        cluster.options, cluster.typed = map(list, words)
        corners = 0.5 * np.vstack([np.zeros(3), np.eye(3)])
        write_mesh(target, Mesh(corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])))
        return {"summary": "a tetrahedron", "spacing": 0.125, "command": ["of the head"]}

    cluster.run = run  # type: ignore[assignment, method-assign]
    page, png = tmp_path / "r.html", tmp_path / "r.png"
    submit(tmp_path, sphere_file, "--grid", "32", "--report", page, "--png", png)
    assert cluster.options == ["--grid", "32", "--details"]
    mesh = str(tmp_path / "m.ply")
    assert cluster.typed == ["reconstruct", str(sphere_file), "--output", mesh, "--grid", "32",
                             "--cluster", "cluster.yaml", "--report", str(page),
                             "--png", str(png)]  # fmt: skip
    shown = page.read_text()
    assert "a tetrahedron" in shown
    assert "0.125" in shown
    assert "--cluster cluster.yaml" in shown
    assert "of the head" not in shown
    assert png.read_bytes().startswith(b"\x89PNG")


def test_the_place_of_a_fetched_mesh_is_beside_it(
    tmp_path: Path, sphere_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    origin = [5.0e5, 5.4e6, 0.0]

    def run(path: Path, verb: str, points: Path, target: Path, *words: Sequence[str]) -> object:
        write_mesh(target, Mesh(np.eye(3), np.array([[0, 1, 2]])))
        return {"summary": "a mesh", "origin": origin, "input": {"crs": "EPSG:2180", "unit": "m"}}

    monkeypatch.setattr(remote, "load_cluster_function", lambda name: run)
    submit(tmp_path, sphere_file, output="m.glb")
    assert read_mesh(tmp_path / "m.glb").origin.tolist() == origin
    assert find_mesh_crs(tmp_path / "m.glb").text == "EPSG:2180"


LIES: list[dict[str, object]] = [
    {"spacing": "narrow"},
    {"stages": {"fit": 1e400}},
    {"timeline": {"spans": [{"name": "fit"}]}},
    {"warnings": 7},
    {"owners": {"tiles": "x"}},
    {"origin": [1.0, 2.0]},
    {"origin": [0.0, 0.0, 1e400]},
    {"input": {"crs": 7}},
]


@pytest.mark.parametrize("lie", LIES)
def test_a_report_of_a_head_that_lies_makes_no_page(
    tmp_path: Path, sphere_file: Path, lie: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(path: Path, verb: str, points: Path, target: Path, *words: Sequence[str]) -> object:
        write_mesh(target, Mesh(np.eye(3), np.array([[0, 1, 2]]), np.zeros(3)))
        return {"summary": "a mesh", **lie}

    monkeypatch.setattr(remote, "load_cluster_function", lambda name: run)
    with pytest.raises(InputError, match="the head's report: "):
        submit(tmp_path, sphere_file, "--report", tmp_path / "r.html")
    assert not (tmp_path / "r.html").exists()
    assert (tmp_path / "m.ply").exists()  # what has come stays


def test_a_texture_in_files_of_its_own_is_not_made_there(
    tmp_path: Path, sphere_file: Path, cluster: Cluster
) -> None:
    words = "--faces", "100", "--texture", "256"
    with pytest.raises(UsageError, match="several files, and one comes from a cluster"):
        submit(tmp_path, sphere_file, *words, output="m.obj")
    assert cluster.options == []


def test_a_mesh_that_is_not_read_here_has_no_page_here(
    tmp_path: Path, sphere_file: Path, cluster: Cluster
) -> None:
    with pytest.raises(UsageError, match="not read here"):
        submit(tmp_path, sphere_file, "--report", tmp_path / "r.html", output="m.3mf")
    assert cluster.options == []
