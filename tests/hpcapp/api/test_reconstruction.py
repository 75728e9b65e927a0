from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from little_memory import leave_little_memory
from numpy.typing import NDArray

import hpcapp
from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.normals.viewpoint import parse_viewpoint
from hpcapp.cli import _run
from hpcapp.geometry.points import PointCloud
from hpcapp.io import read_points, write_points
from hpcapp.progress import Progress
from hpccomponent.errors import HpcError, InputError, MissingLibraryError, UsageError

FAR = np.array([5_400_000.0, 400_000.0, 100.0])


@pytest.mark.parametrize(
    "options",
    [
        {"grid": 32},
        {"voxel_size": 0.08, "detail": 0.5, "smoothness": 2.0, "clean": False},
        {"grid": 32, "method": hpcapp.Paper(delta=0.2)},
        {"grid": 32, "executor": "threads", "workers": 3},
    ],
)
def test_the_mesh_has_the_bytes_of_the_commands(
    options: dict[str, Any], sphere_file: Path, tmp_path: Path
) -> None:
    cloud = read_points(sphere_file)
    assert cloud.normals is not None
    mesh = hpcapp.reconstruct(cloud.positions, cloud.normals, **options)
    mesh.save(tmp_path / "api.ply")
    named = {"backend": options.get("executor", "auto")}
    typed = {name: value for name, value in options.items() if name != "executor"} | named
    own = {name: typed.pop(name) for name in ("smoothness", "detail", "clean") if name in typed}
    typed.setdefault("method", hpcapp.Hierarchical(**own))
    run_job(JobSettings(sphere_file, str(tmp_path / "job.ply"), **typed), Progress())
    assert (tmp_path / "api.ply").read_bytes() == (tmp_path / "job.ply").read_bytes()


def test_a_georeferenced_cloud_comes_back_in_its_own_coordinates(
    sphere: PointCloud, tmp_path: Path
) -> None:
    assert sphere.normals is not None
    rows = np.hstack([sphere.positions + FAR, sphere.normals])
    np.savetxt(tmp_path / "far.xyz", rows, fmt="%.17g")
    mesh = hpcapp.reconstruct(rows[:, :3], rows[:, 3:], grid=32)
    radii = np.linalg.norm(mesh.vertices - FAR, axis=1)
    assert np.abs(radii - 1.0).max() < 0.03
    assert np.abs(mesh.origin - FAR).max() <= 1.0
    mesh.save(tmp_path / "api.ply")
    run_job(JobSettings(tmp_path / "far.xyz", str(tmp_path / "job.ply"), grid=32), Progress())
    assert (tmp_path / "api.ply").read_bytes() == (tmp_path / "job.ply").read_bytes()


@pytest.mark.parametrize("method", ["hierarchical", "paper"])
def test_points_alone_get_normals(method: str, sphere: PointCloud, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "bare.xyz", sphere.positions, fmt="%.17g")
    mesh = hpcapp.reconstruct(sphere.positions, grid=32, method=method)
    radii = np.linalg.norm(mesh.vertices, axis=1)
    assert np.abs(radii - 1.0).mean() < 0.02
    mesh.save(tmp_path / "api.ply")
    settings = JobSettings(
        tmp_path / "bare.xyz",
        str(tmp_path / "job.ply"),
        grid=32,
        method=hpcapp.Paper() if method == "paper" else hpcapp.Hierarchical(),
    )
    report = run_job(settings, Progress())
    assert report["normals"] == {
        "source": "estimated",
        "sure": 1.0,
        "turned": 0,
        "seen": "from outside",
    }
    assert (tmp_path / "api.ply").read_bytes() == (tmp_path / "job.ply").read_bytes()


@pytest.mark.parametrize("viewpoint", ["below", [0.1, 0.0, 0.0], [[0.1, 0.0, 0.0]]])
def test_a_viewpoint_is_what_the_command_takes(
    sphere: PointCloud, tmp_path: Path, viewpoint: Any
) -> None:
    np.savetxt(tmp_path / "bare.xyz", sphere.positions, fmt="%.17g")
    mesh = hpcapp.reconstruct(sphere.positions, grid=32, viewpoints=viewpoint)
    mesh.save(tmp_path / "api.ply")
    told = parse_viewpoint(["below" if viewpoint == "below" else "0.1,0,0"])
    output = tmp_path / "job.ply"
    run_job(JobSettings(tmp_path / "bare.xyz", str(output), grid=32, viewpoint=told), Progress())
    assert (tmp_path / "api.ply").read_bytes() == output.read_bytes()


def test_lists_and_single_precision_are_arrays_too(sphere: PointCloud) -> None:
    assert sphere.normals is not None
    points, normals = sphere.positions.astype(np.float32), sphere.normals.astype(np.float32)
    single = hpcapp.reconstruct(points, normals, grid=32)
    listed = hpcapp.reconstruct(points.tolist(), normals.tolist(), grid=32)
    assert single.vertices.dtype == np.float64
    assert single.vertices.tobytes() == listed.vertices.tobytes()
    assert single.faces.tobytes() == listed.faces.tobytes()


def test_the_arrays_that_were_given_stay_as_they_are(sphere: PointCloud) -> None:
    assert sphere.normals is not None
    points, normals = sphere.positions + FAR, 3.0 * sphere.normals
    before = points.copy(), normals.copy()
    hpcapp.reconstruct(points, normals, grid=32)
    np.testing.assert_array_equal((points, normals), before)


def test_progress_counts_each_stage_from_none_to_all(sphere: PointCloud) -> None:
    assert sphere.normals is not None
    seen: list[tuple[str, int, int]] = []
    hpcapp.reconstruct(
        sphere.positions, sphere.normals, grid=32, on_progress=lambda *told: seen.append(told)
    )
    stages = list(dict.fromkeys(stage for stage, _, _ in seen))
    assert stages[-2:] == ["extract", "close"]
    for stage in stages:
        told = [(done, total) for name, done, total in seen if name == stage]
        assert told[0] == (0, 1)
        assert told[-1][0] == told[-1][1]
        shares = [done / total for done, total in told]
        assert shares == sorted(shares)


def test_what_progress_raises_ends_the_job(sphere: PointCloud) -> None:
    def stop(stage: str, done: int, total: int) -> None:
        raise KeyError(stage)

    assert sphere.normals is not None
    with pytest.raises(KeyError, match="arrange"):
        hpcapp.reconstruct(sphere.positions, sphere.normals, grid=32, on_progress=stop)


GOOD = np.random.default_rng(5).normal(size=(50, 3))


def spoilt(row: int, value: float) -> NDArray[np.generic]:
    rows = GOOD.copy()
    rows[row] = value
    return rows


@pytest.mark.parametrize(
    ("points", "normals", "words"),
    [
        (GOOD[0], GOOD, r"points has the shape \(3,\), not \(n, 3\)"),
        (GOOD, GOOD[:, :2], r"normals has the shape \(50, 2\)"),
        (GOOD, GOOD[:-1], "points has 50 rows and normals 49"),
        ([[0.0, 1.0, 2.0], [3.0]], GOOD, "points is no array"),
        (GOOD.astype(str), GOOD, "points holds <U32, not numbers"),
        (GOOD.astype(complex), GOOD, "points holds complex128"),
        (spoilt(7, np.nan), GOOD, r"points has 1 of 50 rows with NaN or infinity, .* points\[7\]"),
        (
            GOOD,
            spoilt(9, np.inf),
            r"normals has 1 of 50 rows with NaN or infinity, .* normals\[9\]",
        ),
        (GOOD, spoilt(9, 0.0), "normals has 1 of 50 rows of length zero"),
        (GOOD[:4], GOOD[:4], "points has 4 usable points"),
        (np.zeros((0, 3)), np.zeros((0, 3)), "points holds no points"),
        (np.ones((50, 3)), GOOD, "points: all 50 points lie in one place"),
        (GOOD * 1e80, GOOD, "points: the largest coordinate is"),
    ],
)
def test_a_wrong_array_is_named(points: Any, normals: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        hpcapp.reconstruct(points, normals)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"grid": 8}, "grid is 8; give a number from 16 to 4096"),
        ({"grid": 64.5}, "grid is 64.5; give a whole number"),
        ({"grid": 64, "voxel_size": 0.1}, "exclude each other"),
        ({"voxel_size": -1.0}, "give a number above 0"),
        ({"voxel_size": 1e9}, "choose one that gives 16 to 4096"),
        ({"smoothness": 0.0}, "smoothness is 0.0"),
        ({"detail": float("nan")}, "detail is nan"),
        ({"method": "poisson"}, "unknown method 'poisson'"),
        ({"viewpoints": "up"}, "'up' is neither above, below, inside, outside, nor"),
        ({"viewpoints": "no,1,2"}, "'no,1,2' is neither"),
        ({"viewpoints": [[0, 0, 1e300]]}, r"viewpoints has \[0.0, 0.0, 1e\+300\]"),
        ({"executor": "cloud"}, "unknown backend 'cloud'"),
        ({"executor": "serial", "workers": 2}, "cannot have 2 workers"),
    ],
)
def test_a_wrong_option_is_named(options: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError, match=words) as caught:
        hpcapp.reconstruct(GOOD, GOOD, **options)
    assert isinstance(caught.value, HpcError)


def write_scan(path: Path, cloud: PointCloud) -> Path:
    write_points(path, cloud)
    return path


@pytest.mark.parametrize("suffix", [".ply", ".glb", ".stl"])
@pytest.mark.parametrize("shift", [np.zeros(3), FAR])
def test_a_file_gives_the_bytes_of_the_command(
    sphere: PointCloud, tmp_path: Path, suffix: str, shift: NDArray[np.float64]
) -> None:
    colours = np.full((len(sphere), 3), 90, np.uint8)
    scan = write_scan(
        tmp_path / "scan.ply", PointCloud(sphere.positions + shift, sphere.normals, colours)
    )
    command = ["reconstruct", str(scan), "-o", str(tmp_path / f"job{suffix}"), "--grid", "32"]
    assert _run([*command, "--attributes", "auto,normals"], debug=False) == 0
    mesh = hpcapp.reconstruct(scan, grid=32, attributes="auto,normals")
    mesh.save(tmp_path / f"api{suffix}")
    job = (tmp_path / f"job{suffix}").read_bytes()
    assert (tmp_path / f"api{suffix}").read_bytes() == job
    assert mesh.facts["input"]["files"] == [str(scan)]


@pytest.mark.parametrize("suffix", [".ply", ".glb", ".3mf"])
@pytest.mark.parametrize("height_unit", [None, "m"])
def test_a_mesh_of_a_survey_says_what_its_coordinates_mean_as_the_commands(
    sphere: PointCloud, tmp_path: Path, suffix: str, height_unit: str | None
) -> None:
    pytest.importorskip("laspy", reason="laspy is not installed")
    scan = tmp_path / "scan.las"
    ball = PointCloud(100.0 * sphere.positions + FAR, sphere.normals)
    write_points(scan, ball, "EPSG:2229", "US ft", height_unit=height_unit)
    job, own = tmp_path / f"job{suffix}", tmp_path / f"api{suffix}"
    assert _run(["reconstruct", str(scan), "-o", str(job), "--grid", "32"], debug=False) == 0
    mesh = hpcapp.reconstruct(scan, grid=32)
    mesh.save(own)
    assert own.read_bytes() == job.read_bytes()
    if suffix == ".ply":
        assert b"\ncomment crs EPSG:2229\n" in own.read_bytes()
        hpcapp.read_mesh(own).save(tmp_path / "again.ply")
        assert (tmp_path / "again.ply").read_bytes() == job.read_bytes()


@pytest.mark.parametrize(
    ("package", "name", "options"),
    [("pye57", "scan.e57", {}), ("lazrs", "scan.laz", {})],
)
def test_a_library_that_is_missing_is_an_import_error_too(
    sphere: PointCloud,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    package: str,
    name: str,
    options: dict[str, Any],
) -> None:
    pytest.importorskip(package, reason=f"{package} is not installed")
    scan = write_scan(tmp_path / name, sphere)
    for library in (package, "laszip"):
        monkeypatch.setitem(sys.modules, library, None)  # as if it were not installed
    with pytest.raises(ImportError, match=f"{package}.*pip install") as caught:
        hpcapp.reconstruct(scan, **options)
    assert isinstance(caught.value, MissingLibraryError)
    flags = [f"--{option}={value}" for option, value in options.items()]
    assert _run(["reconstruct", str(scan), "-o", str(tmp_path / "a.ply"), *flags], debug=False) == 2


def test_several_files_and_patterns_are_one_cloud(sphere: PointCloud, tmp_path: Path) -> None:
    half = len(sphere) // 2
    names = [
        write_scan(tmp_path / f"{name}.ply", sphere.view(rows))
        for name, rows in (("a", slice(0, half)), ("b", slice(half, None)))
    ]
    whole = hpcapp.reconstruct(sphere, grid=32)
    for points in (names, tuple(map(str, names)), str(tmp_path / "?.ply")):
        mesh = hpcapp.reconstruct(points, grid=32)
        assert mesh.facts["points"] == whole.facts["points"]
        assert np.abs(mesh.bounds - whole.bounds).max() < 1e-5


def test_points_are_taken_from_meshes_where_they_are_asked_for(tmp_path: Path) -> None:
    solid = hpcapp.reconstruct(hpcapp.simulate("torus", points=4000), grid=48)
    solid.save(tmp_path / "solid.stl")
    mesh = hpcapp.reconstruct(tmp_path / "solid.stl", sample=4000, grid=32)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(solid.volume, rel=0.05)
    with pytest.raises(UsageError, match="sample is for files"):
        hpcapp.reconstruct(GOOD, sample=100)


def test_normals_are_treated_as_the_command_treats_them(sphere: PointCloud, tmp_path: Path) -> None:
    assert sphere.normals is not None
    inwards = PointCloud(sphere.positions, -sphere.normals)
    scan = write_scan(tmp_path / "scan.ply", inwards)
    for points in (scan, inwards):
        mesh = hpcapp.reconstruct(points, "estimate", grid=32)
        assert mesh.facts["normals"]["source"] == "estimated"
        assert mesh.volume == pytest.approx(4.0 / 3.0 * np.pi, rel=0.02)
        kept = hpcapp.reconstruct(points, normals="file", grid=32)
        assert kept.facts["normals"]["source"] == "file"
    with pytest.raises(UsageError, match="normals is 'keep'; choose auto, file, estimate"):
        hpcapp.reconstruct(scan, normals="keep")
    with pytest.raises(UsageError, match="normals stands beside files"):
        hpcapp.reconstruct(scan, GOOD)


def test_steps_before_all_else_can_be_asked_for(sphere: PointCloud) -> None:
    seen: list[str] = []
    hpcapp.reconstruct(
        sphere, grid=32, outliers=True, denoise=True, resample=True,
        on_progress=lambda stage, done, total: seen.append(stage),
    )  # fmt: skip
    assert {"remove outliers", "denoise", "resample"} <= set(seen)


@pytest.mark.parametrize(
    "call",
    [
        lambda: hpcapp.reconstruct("no-such-scan.laz"),
        lambda: hpcapp.reconstruct("none/*.laz"),
        lambda: hpcapp.reconstruct(GOOD, GOOD, viewpoints="sideways"),
        lambda: hpcapp.reconstruct(GOOD, GOOD, attributes="intensity"),
        lambda: hpcapp.reconstruct(GOOD, GOOD, voxel_size=1e9),
        lambda: hpcapp.reconstruct(GOOD, GOOD, method=hpcapp.Paper(), grid=4096),
        lambda: hpcapp.reconstruct(GOOD, GOOD, executor="serial", workers=2),
        lambda: hpcapp.reconstruct(GOOD, GOOD, executor="threads", verify=0.5),
        lambda: hpcapp.reconstruct(GOOD, GOOD, executor="zmq", workers=100_000),
        lambda: hpcapp.Hierarchical(close="yes", trim="3s"),
        lambda: hpcapp.Paper(patches=9, max_points=5),
    ],
)
def test_no_error_speaks_of_flags(call: Callable[[], object]) -> None:
    with pytest.raises(HpcError) as caught:
        call()
    assert "--" not in str(caught.value)


def test_files_larger_than_memory_give_the_same_mesh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan = tmp_path / "scan.ply"
    hpcapp.write_points(scan, hpcapp.simulate("torus", points=20_000))
    whole = hpcapp.reconstruct(scan, grid=64)
    leave_little_memory(monkeypatch)
    bounded = hpcapp.reconstruct(
        scan, grid=64, max_memory="1G", temp_dir=tmp_path / "left", resume=True
    )
    np.testing.assert_array_equal(bounded.vertices, whole.vertices)
    np.testing.assert_array_equal(bounded.faces, whole.faces)
    assert list((tmp_path / "left").iterdir()) == []
    with pytest.raises(hpcapp.UsageError, match="hpcapp reconstruct --report"):
        bounded.report(tmp_path / "page.html")


@pytest.mark.parametrize("asked", [{"temp_dir": "here"}, {"resume": True}])
def test_a_folder_is_for_files(asked: dict[str, Any], sphere: PointCloud) -> None:
    with pytest.raises(hpcapp.UsageError, match="are for files"):
        hpcapp.reconstruct(sphere.positions, sphere.normals, **asked)


def test_going_on_needs_a_folder(tmp_path: Path) -> None:
    hpcapp.write_points(tmp_path / "scan.ply", hpcapp.simulate("torus", points=500))
    with pytest.raises(hpcapp.UsageError, match="temp-dir"):
        hpcapp.reconstruct(tmp_path / "scan.ply", resume=True)
