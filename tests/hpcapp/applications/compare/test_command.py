"""The command ``compare``: known distances, as a table, as JSON and on a page."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from verbs import run_verb

from hpcapp.applications.compare.command import compare
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io import read_points, write_mesh, write_points
from hpccomponent.errors import InputError, UsageError

CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
])  # fmt: skip
FAR = np.array([4e5, 5e6, 0.0])


run = partial(run_verb, compare)


def measure(*words: str | Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(run(*words, "--json", "--samples", "2000"))
    return found


@pytest.fixture
def cube(tmp_path: Path) -> Path:
    write_mesh(tmp_path / "cube.ply", Mesh(CORNERS, FACES, FAR))
    return tmp_path / "cube.ply"


def test_a_mesh_is_at_no_distance_from_itself(cube: Path) -> None:
    found = measure(cube, cube)
    assert found["hausdorff"] < 1e-7
    assert found["diagonal"] == pytest.approx(3**0.5)
    assert found["f_scores"] == {"0.02": 1.0, "0.1": 1.0, "0.5": 1.0}
    assert found["topology"]["watertight"]


def test_a_larger_cube_is_as_far_away_as_it_is_larger(cube: Path, tmp_path: Path) -> None:
    write_mesh(tmp_path / "more.ply", Mesh(1.2 * CORNERS - 0.1, FACES, FAR))
    found = measure(tmp_path / "more.ply", cube)
    unit = found["diagonal"] / 100
    assert found["completeness"] * unit == pytest.approx(0.1, rel=1e-6)
    assert 0.1 < found["accuracy"] * unit < 0.11  # corners are farther away
    assert 0.1 <= found["hausdorff"] * unit <= 0.1 * 3**0.5
    assert found["normal_deg"] < 1e-3


def test_points_are_a_truth(cube: Path, tmp_path: Path) -> None:
    write_points(tmp_path / "c.ply", PointCloud(CORNERS, origin=FAR))
    found = measure(cube, tmp_path / "c.ply")
    assert found["completeness"] < 1e-9
    assert found["accuracy"] > 10.0  # eight corners are far from most of the faces
    assert found["normal_deg"] is None


def test_a_shape_is_a_truth(tmp_path: Path) -> None:
    write_mesh(tmp_path / "cube.ply", Mesh(2 * CORNERS - 1, FACES))
    assert measure(tmp_path / "cube.ply", "shape:sphere")["accuracy"] > 1.0


def test_an_open_truth_leaves_half_unsaid(cube: Path, tmp_path: Path) -> None:
    write_mesh(tmp_path / "open.ply", Mesh(CORNERS, FACES[2:], FAR))
    assert measure(cube, tmp_path / "open.ply")["accuracy"] is None
    assert "open" in run(cube, tmp_path / "open.ply")


def test_the_table_has_every_measure(cube: Path) -> None:
    table = run(cube, cube, "--threshold", "0.3")
    for words in ("L1", "root mean square", "95 %", "Hausdorff", "F-score at 0.3 %", "watertight"):
        assert words in table


def test_a_seed_gives_the_same_again(cube: Path, tmp_path: Path) -> None:
    write_mesh(tmp_path / "more.ply", Mesh(1.2 * CORNERS, FACES, FAR))
    first, again, other = (
        measure(tmp_path / "more.ply", cube, "--seed", seed) for seed in ("1", "1", "2")
    )
    assert first == again != other


def test_the_page_is_coloured_by_the_distance(cube: Path, tmp_path: Path) -> None:
    write_mesh(tmp_path / "more.ply", Mesh(1.2 * CORNERS - 0.1, FACES, FAR))
    run(tmp_path / "more.ply", cube, "--html", tmp_path / "p.html")
    page = (tmp_path / "p.html").read_text()
    scene = json.loads(page.split('id="scene">')[1].split("</script>")[0])
    assert scene["fields"][0]["name"] == "distance"
    assert scene["fields"][0]["high"] == pytest.approx(0.1 * 3**0.5)
    assert "Hausdorff" in page


def test_what_cannot_be_compared_is_said(cube: Path, tmp_path: Path) -> None:
    write_points(tmp_path / "c.ply", PointCloud(CORNERS))
    for words, error in (
        ((tmp_path / "c.ply", cube), InputError),
        ((cube, tmp_path / "none.ply"), InputError),
        ((cube, "shape:sphere"), InputError),
        ((cube, cube, "--html", tmp_path / "p.txt"), UsageError),
    ):
        with pytest.raises(error):
            run(*words)


@pytest.mark.parametrize("count", [1, 20])
def test_a_truth_at_one_place_is_refused(cube: Path, tmp_path: Path, count: int) -> None:
    write_points(tmp_path / "same.ply", PointCloud(np.ones((count, 3))))
    with pytest.raises(InputError, match=r"same\.ply: all of it is at one place"):
        run(cube, tmp_path / "same.ply")


def test_the_side_is_known_of_a_closed_truth(cube: Path, tmp_path: Path) -> None:
    ends = {}
    for name, size in (("more", 1.2), ("less", 0.8)):
        path = tmp_path / f"{name}.ply"
        write_mesh(path, Mesh(size * (CORNERS - 0.5) + 0.5, FACES, FAR))
        run(path, cube, "--html", tmp_path / "p.html")
        page = (tmp_path / "p.html").read_text()
        [field] = [
            one
            for one in json.loads(page.split('id="scene">')[1].split("</script>")[0])["fields"]
            if one["name"] == "distance"
        ]
        assert field["signed"]
        ends[name] = field["from"], field["to"]
    assert ends["more"][1] == pytest.approx(0.1 * 3**0.5)  # corners, outside
    assert ends["less"][0] == pytest.approx(-0.1)  # the nearest side, inside


def test_columns_stand_apart_and_lengths_have_a_unit(cube: Path, tmp_path: Path) -> None:
    cloud = PointCloud(np.tile(CORNERS, (3, 1)) * 2.0)
    write_points(tmp_path / "t.e57", cloud)  # in metres, as the format has it
    write_mesh(tmp_path / "m.ply", Mesh(CORNERS * 2.0, FACES))
    lines = run(tmp_path / "m.ply", tmp_path / "t.e57").splitlines()
    [diagonal] = [line for line in lines if line.startswith("diagonal")]
    assert diagonal.split()[-3:] == ["3.46", "m", "100.0000"]
    [head] = [line for line in lines if "% of diagonal" in line]
    assert head.index("length") + len("length") == diagonal.index(" m ") + 2


def test_progress_is_told_as_it_comes(cube: Path) -> None:
    done = CliRunner().invoke(compare, [str(cube), str(cube)], catch_exceptions=False)
    stages = [line.split(":")[0] for line in done.stderr.splitlines() if ": done in" in line]
    assert stages == ["read", "truth to mesh", "mesh to truth", "check"]
    assert "done in" not in done.stdout


@pytest.fixture
def epochs(tmp_path: Path) -> tuple[Path, Path]:
    rng = np.random.default_rng(0)
    paths = tmp_path / "june.ply", tmp_path / "may.ply"
    for path, height in zip(paths, (1.0, 0.0), strict=True):
        points = rng.random((20_000, 3)) * [10.0, 10.0, 0.02]
        points[:, 2] += height * (np.hypot(*(points[:, :2] - 5.0).T) < 2.0)
        write_points(path, PointCloud(points, origin=FAR))
    return paths


def test_volumes_are_a_table_json_a_page_and_a_picture(
    epochs: tuple[Path, Path], tmp_path: Path
) -> None:
    page, picture = tmp_path / "p.html", tmp_path / "p.png"
    table = run(*epochs, "--volume", "--html", page, "--png", picture).splitlines()
    found = json.loads(run(*epochs, "--volume", "--json"))
    fill = found["fill"]
    assert abs(fill["volume"] - 4.0 * np.pi) < fill["uncertainty"] < 0.5
    assert table[2].split()[:2] == ["fill", f"{fill['volume']:.1f}"]
    assert "nothing is counted on" in table[-1]
    text = page.read_text()
    assert f"{fill['volume']:.1f}" in text
    scene = json.loads(text.split('id="scene">')[1].split("</script>")[0])
    assert scene["fields"][0]["name"] == "change"
    assert scene["fields"][0]["sides"] == ["cut", "fill"]
    assert 0.8 < scene["fields"][0]["high"] < 1.2
    with Image.open(picture) as drawn:
        pixels = np.asarray(drawn.convert("RGB")).reshape(-1, 3).astype(int)
    red = (pixels[:, 0] - pixels[:, 1:].max(axis=1) > 60).mean()
    blue = (pixels[:, 2] - pixels[:, :2].max(axis=1) > 60).mean()
    assert red > 0.01 > 10.0 * blue  # the heap, and of blue the patch in the caption


def test_a_shift_is_warned_of(
    epochs: tuple[Path, Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    cloud = read_points(epochs[0])
    moved = cloud.positions + np.array([0.0, 0.0, 0.1])
    write_points(tmp_path / "moved.ply", PointCloud(moved, origin=cloud.origin))
    run(*epochs, "--volume")
    assert "register them" not in caplog.text
    run(tmp_path / "moved.ply", epochs[1], "--volume")
    assert "a shift of NEW by" in caplog.records.pop().getMessage()
    found = json.loads(
        run(tmp_path / "moved.ply", epochs[1], "--volume", "--registration", "0.01", "--json")
    )
    assert found["registration"] == 0.01
    assert found["net"]["volume"] == pytest.approx(4.0 * np.pi + 10.0, rel=0.05)


def test_options_of_the_other_kind_are_refused(epochs: tuple[Path, Path], cube: Path) -> None:
    for words, problem in (
        ((*epochs, "--volume", "--samples", "500"), "--samples is for distances"),
        ((*epochs, "--volume", "--threshold", "1"), "--threshold is for distances"),
        ((cube, cube, "--cell", "1"), "--cell is for volumes"),
        ((cube, cube, "--png", "c.png"), "--png is for volumes"),
    ):
        with pytest.raises(UsageError, match=problem):
            run(*words)
    with pytest.raises(UsageError, match="is no scan"):
        run(cube, "shape:knot", "--volume")
