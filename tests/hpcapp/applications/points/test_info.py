import json
from pathlib import Path

import numpy as np
import pytest

from hpcapp.applications.points.info import describe, describe_file, measure_spacing
from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.geometry.points import PointCloud
from hpcapp.io import open_points
from hpcapp.progress import Progress


def grid(step: float = 0.25) -> np.ndarray:
    """Corners of 8 x 8 x 8 cubes."""
    return np.stack(np.meshgrid(*[np.arange(9)] * 3), axis=-1).reshape(-1, 3) * step


def test_a_grid_is_measured() -> None:
    facts = describe(PointCloud(grid()))
    assert facts["points"] == 729
    assert facts["bounds"] == [[0, 0, 0], [2, 2, 2]]
    assert facts["extent"] == [2, 2, 2]
    assert facts["diagonal"] == pytest.approx(np.sqrt(12))
    assert facts["duplicates"] == 0
    assert not facts["has_normals"]
    assert not facts["has_colours"]


@pytest.mark.parametrize(("flipped", "is_oriented"), [(0.035, True), (0.09, False)])
def test_normals_that_contradict_each_other_have_no_side(
    flipped: float, is_oriented: bool, tmp_path: Path
) -> None:
    """Opposed are 6.8 and 16 % of the pairs."""
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(20_000, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    signs = np.where(rng.random(20_000) < flipped, -1.0, 1.0)[:, None]
    np.savetxt(tmp_path / "ball.xyzn", np.hstack([normals, signs * normals]))
    facts, _, _ = describe_file(open_points(tmp_path / "ball.xyzn"))
    assert facts["opposed_normals"] == pytest.approx(2 * flipped * (1 - flipped), abs=0.015)
    assert facts["is_oriented"] is is_oriented


def test_a_warning_says_what_is_no_surface(tmp_path: Path) -> None:
    path = tmp_path / "grid.xyz"
    np.savetxt(path, grid())
    facts, findings, _ = describe_file(open_points(path))
    assert [line.partition(":")[0] for line in findings.lines()] == ["the points fill a volume"]
    assert facts["warnings"] == findings.lines()
    np.savetxt(path, grid()[grid()[:, 0] == 0.0])
    assert describe_file(open_points(path))[0]["warnings"] == []


def test_bounds_are_in_the_coordinates_of_the_input() -> None:
    facts = describe(PointCloud(grid(), origin=np.array([5.4e6, 0.0, -10.0])))
    assert facts["bounds"] == [[5400000, 0, -10], [5400002, 2, -8]]
    assert facts["origin"] == [5400000, 0, -10]


def test_what_is_wrong_is_counted_and_does_not_disturb() -> None:
    positions = np.vstack([grid(), grid()[:5], grid()[:1], [[np.nan, 0, 0], [0, np.inf, 900]]])
    normals = np.ones((len(positions), 3))
    normals[[3, 4, 5]] = 0.0
    normals[7, 1] = np.nan
    colours = np.zeros((len(positions), 3), np.uint8)
    facts = describe(PointCloud(positions, normals, colours))
    assert facts["points"] == 737
    assert facts["non_finite_points"] == 2
    assert facts["non_finite_normals"] == 1
    assert facts["zero_normals"] == 3
    assert facts["duplicates"] == 6
    assert facts["bounds"] == [[0, 0, 0], [2, 2, 2]]
    assert facts["has_normals"]
    assert facts["has_colours"]


def test_the_spacing_is_that_of_the_job(tmp_path: Path) -> None:
    """Strays and repeated points do not count; so many points lie on a ball, evenly."""
    rng = np.random.default_rng(7)
    ball = rng.normal(size=(20_000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    scan = np.vstack([ball, ball[:300], rng.uniform(-3, 3, (60, 3))])
    np.savetxt(tmp_path / "scan.xyz", scan)
    facts, _, _ = describe_file(open_points(tmp_path / "scan.xyz"))
    settings = JobSettings(tmp_path / "scan.xyz", str(tmp_path / "m.ply"), grid=32)
    assert facts["spacing"] == run_job(settings, Progress())["spacing"]
    assert facts["spacing"] == pytest.approx(np.sqrt(4 * np.pi / len(ball)), rel=0.2)


def test_scan_lines_are_told_as_the_job_takes_them(tmp_path: Path) -> None:
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 5, 0.1), np.arange(0, 5, 0.008)))
    np.savetxt(tmp_path / "lines.xyz", np.stack([x, y, 0.3 * np.sin(x) * np.cos(y)], axis=1))
    facts, _, _ = describe_file(open_points(tmp_path / "lines.xyz"))
    settings = JobSettings(tmp_path / "lines.xyz", str(tmp_path / "m.ply"), grid=32)
    told = facts["scan_lines"]
    assert told == run_job(settings, Progress())["scan_lines"]
    assert isinstance(told, dict)
    assert told["gap"] == pytest.approx(0.1, rel=0.25)
    assert told["step"] == pytest.approx(0.008, rel=0.5)
    assert told["spared"] > 0.7 * len(x)


@pytest.mark.parametrize("positions", [np.empty((0, 3)), np.full((3, 3), np.nan)])
def test_nothing_to_measure_is_none(positions: np.ndarray) -> None:
    facts = describe(PointCloud(positions))
    assert facts["bounds"] is None
    assert measure_spacing(PointCloud(positions))["spacing"] is None
    assert facts["points"] == len(positions)


def test_the_facts_are_json() -> None:
    facts = describe(PointCloud(grid(), grid(), np.zeros((729, 3), np.uint8)))
    assert json.loads(json.dumps(facts)) == facts


def test_all_that_a_file_holds_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = [f"{x},{y},{z},0,0,0,{i % 7},9" for i, (x, y, z) in enumerate(grid())]
    rows += ["0,0,0,0,0,0,0,9"] * 40 + ["nan,0,0,0,0,0,1,9"]
    names = "x,y,z,nx,ny,nz,classification,mark"
    path.write_text("\n".join([names, *rows]) + "\n")
    facts, findings, cloud = describe_file(open_points(path))
    assert json.loads(json.dumps(facts)) == facts
    assert facts["points"] == len(cloud) == 729
    assert (
        facts["dropped"] == findings.dropped == {"repeated": 41, "not finite": 1}
    )  # one is in the grid
    assert facts["normals"] is None
    assert facts["columns"] == {
        "x": "position", "y": "position", "z": "position",
        "nx": "left out", "ny": "left out", "nz": "left out",
        "classification": "attribute", "mark": "attribute",
    }  # fmt: skip
    assert facts["attributes"] == ["classification", "mark"]
    assert isinstance(scans := facts["scans"], list)
    assert len(scans) == 1
    assert facts["warnings"] == findings.warnings
    warned = "\n".join(findings.warnings)
    assert "origin" in warned
    assert "normals" in warned
