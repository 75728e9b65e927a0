"""The page of a job: in memory, out of core, on workers and fetched from a cluster."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from directions import random_directions

from hpcapp.applications.surface.cli.command import reconstruct
from hpcapp.applications.surface.steps.report_page import (
    Shown,
    build_job_page,
    find_guesses,
    show_files,
)
from hpcapp.applications.view.page import make_page
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io import read_mesh, write_points
from hpcapp.wording import say_number
from hpccomponent.errors import UsageError


def run(*words: str | Path) -> dict[str, Any]:
    done = CliRunner().invoke(reconstruct, [*map(str, words), "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    report: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return report


def scene_of(page: str) -> dict[str, Any]:
    scene: dict[str, Any] = json.loads(page.split('id="scene">')[1].split("</script>")[0])
    return scene


def names_of(page: str) -> set[str]:
    return {field["name"] for field in scene_of(page)["fields"]}


@pytest.fixture
def capless(sphere: PointCloud, tmp_path: Path) -> Path:
    """Points of a sphere without its top."""
    more = random_directions(6000, 1)
    more = more[more[:, 2] < 0.75]
    write_points(tmp_path / "capless.ply", PointCloud(more, more))
    return tmp_path / "capless.ply"


def test_a_page_says_what_the_job_says(capless: Path, tmp_path: Path) -> None:
    report = run(capless, "-o", tmp_path / "m.ply", "--grid", "48", "--report", tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text()
    assert report["summary"] in page
    assert say_number(report["spacing"]) in page
    assert say_number(report["cell_size"]) in page
    assert "taken as normal" in page
    assert f"reconstruct {capless} --output {tmp_path / 'm.ply'} --grid 48" in page
    assert f"--report {tmp_path / 'r.html'}" in page  # the same command makes the page, too
    assert {"distance", "support", "normals", "plain"} <= names_of(page)
    assert scene_of(page)["points"]["shown"] == report["points"]
    assert "show" in report["stages"]
    # Guesswork is marked where it is.
    [marker] = scene_of(page)["markers"]
    x, y, z = marker["place"]
    assert np.hypot(x, y) < 0.4
    assert z > 0.6
    assert "guesswork" in marker["text"]
    tint = scene_of(page)["tint"]
    assert tint["beyond"] == report["support"]["reach"]
    assert tint["field"] == "distance"


def test_the_axis_that_points_up_and_the_unit_are_those_of_the_scan() -> None:
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    shown = Shown(mesh, 1, PointCloud(np.eye(3)), np.array([0.0, 0.1, 3.5]))
    report = {"summary": "", "spacing": 0.5, "input": {"unit": "m"}, "up": "y"}
    page = build_job_page(shown, report, "t")
    scene = scene_of(page)
    assert (scene["up"], scene["unit"]) == ("y", "m")
    assert "<th>spacing of the points</th><td>0.500 m</td>" in page
    assert scene["tint"]["text"] == "guesswork: more than 3.00 m from every point"
    unknown = scene_of(build_job_page(shown, {"summary": "", "up": "askew"}, "t"))
    assert (unknown["up"], unknown["unit"], unknown["tint"]) == ("z", "", None)


def test_what_points_support_is_not_marked() -> None:
    corners = np.random.default_rng(0).normal(size=(30, 3))
    mesh = Mesh(corners, np.arange(30).reshape(-1, 3))
    assert find_guesses(mesh, np.full(30, 0.1), 6.0, 1.0) == []
    far = np.where(np.arange(30) < 6, 50.0, 0.1)
    markers = find_guesses(mesh, far, 6.0, 1.0)
    assert len(markers) == 2
    middles = mesh.vertices[mesh.faces[:2]].mean(axis=1)
    assert {tuple(one.place) for one in markers} == {tuple(middle) for middle in middles}


def test_a_page_and_a_picture_change_no_byte_of_the_mesh(capless: Path, tmp_path: Path) -> None:
    page, picture = tmp_path / "r.html", tmp_path / "m.png"
    run(capless, "-o", tmp_path / "a.ply", "--grid", "32")
    words = ("--report", page, "--png", picture)
    run(capless, "-o", tmp_path / "b.ply", "--grid", "32", *words)
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_tiles_and_workers_can_be_told_apart(capless: Path, tmp_path: Path) -> None:
    words = (capless, "-o", tmp_path / "m.ply", "--grid", "64", "--report", tmp_path / "r.html")
    report = run(*words, "--backend", "zmq", "--workers", "2")
    page = (tmp_path / "r.html").read_text()
    assert report["tiles"] > 1
    fields = {field["name"]: field for field in scene_of(page)["fields"]}
    assert set(fields["worker"]["labels"]) <= {"machine-0", "machine-1"}
    assert len(fields["tile"]["labels"]) >= report["tiles"]
    assert "machine-0" in page.split("<svg")[1]


def _labels(page: str) -> list[tuple[list[str], str]]:
    """Return the labels of tiles and workers, and the packed number of each vertex."""
    fields = {field["name"]: field for field in scene_of(page)["fields"]}
    found = (fields["tile"], fields["worker"])
    return [
        (one["labels"], page.split(f'id="{one["array"]}"')[1].split("</script>")[0])
        for one in found
    ]


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".glb", ".vtp"])
def test_the_report_of_a_job_elsewhere_tells_tiles_and_workers(
    suffix: str, capless: Path, tmp_path: Path
) -> None:
    mesh, page = tmp_path / f"m{suffix}", tmp_path / "r.html"
    words = (capless, "-o", mesh, "--grid", "64", "--backend", "zmq", "--workers", "2")
    report = run(*words, "--report", page, "--details")
    assert {span["worker"] for span in report["timeline"]["spans"]} >= {"master", "machine-0"}
    assert sum(report["owners"]["vertices"]) == report["vertices"]
    here, there = page.read_text(), build_job_page(show_files(mesh, capless, report), report, "m")
    assert _labels(there) == _labels(here)
    (tmp_path / "r.json").write_text(json.dumps(report))
    seen = make_page(mesh, read_mesh(mesh), report=tmp_path / "r.json")
    assert _labels(seen) == _labels(here)


def test_a_report_without_details_is_short(capless: Path, tmp_path: Path) -> None:
    report = run(capless, "-o", tmp_path / "m.ply", "--grid", "32")
    assert not {"timeline", "owners"} & set(report)
    detailed = run(capless, "-o", tmp_path / "m.ply", "--grid", "32", "--details")
    assert set(detailed) - set(report) == {"timeline"}  # one tile needs no owners
    with pytest.raises(UsageError, match="without --json"):
        CliRunner().invoke(
            reconstruct,
            [str(capless), "-o", str(tmp_path / "m.ply"), "--details"],
            catch_exceptions=False,
        )


@pytest.mark.slow
def test_points_that_lie_in_a_folder_are_near_too(tmp_path: Path) -> None:
    normals = random_directions(60_000, 3)
    write_points(tmp_path / "c.ply", PointCloud(normals, normals))
    pages = []
    there: list[str | Path] = ["--temp-dir", tmp_path / "t", "--backend", "processes"]
    for name, more in (("a", []), ("b", there)):
        page = tmp_path / f"{name}.html"
        words = (tmp_path / "c.ply", "-o", tmp_path / f"{name}.ply", "--grid", "48")
        run(*words, "--report", page, *more)
        pages.append(scene_of(page.read_text()))
    ends = [
        next(field["high"] for field in scene["fields"] if field["name"] == "distance")
        for scene in pages
    ]
    assert ends[0] == pytest.approx(ends[1], rel=1e-9)


def test_a_mesh_that_a_cluster_has_made_has_a_page(capless: Path, tmp_path: Path) -> None:
    report = run(capless, "-o", tmp_path / "m.ply", "--grid", "32")
    shown = show_files(tmp_path / "m.ply", capless, {})
    assert len(shown.mesh.faces) == report["faces"]
    page = build_job_page(shown, report, "m.ply")
    assert scene_of(page)["markers"]
    assert len(read_mesh(tmp_path / "m.ply").faces) == shown.faces
    copy = build_job_page(replace(shown, faces=10 * shown.faces), report, "m.ply")
    assert "A copy with fewer faces is shown" in copy


@pytest.mark.parametrize("flag", [["--report", "no/r.html"], ["--report", "r.pdf"], ["--png", "r"]])
def test_a_page_that_cannot_be_is_refused_before_the_work(
    capless: Path, tmp_path: Path, flag: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(reconstruct, [str(capless), "-o", "m.ply", *flag])
    assert done.exception is not None
    assert [path.name for path in tmp_path.iterdir()] == ["capless.ply"]
