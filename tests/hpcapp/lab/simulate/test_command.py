"""`hpcapp simulate --scene` as its user: three files, or one line that says why not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hpcapp.io import read_mesh, read_points
from hpcapp.lab.simulate.command import SCANNERS as SCANNER_NAMES
from hpcapp.lab.simulate.command import SCENES as SCENE_NAMES
from hpcapp.lab.simulate.raw.scanners import SCANNERS
from hpcapp.lab.simulate.raw.scenes import SCENES

Run = Callable[..., tuple[int, str, str]]


def test_the_help_names_what_there_is() -> None:
    assert tuple(SCENES) == SCENE_NAMES
    assert set(SCANNERS) == set(SCANNER_NAMES)


@pytest.mark.parametrize("suffix", ["laz", "las", "ply", "xyz"])
def test_truth_and_trajectory_lie_beside_the_points(run: Run, suffix: str) -> None:
    if suffix in ("las", "laz"):
        pytest.importorskip("laspy", reason="laspy is not installed")
    scene = ("simulate", "--scene", "forest", "--scanner", "airborne", "-n", "500")
    assert run(*scene, "-o", f"wood.{suffix}")[0] == 0
    assert {p.name for p in Path().iterdir()} == {
        f"wood.{suffix}", "wood_truth.ply", "wood_trajectory.csv",
    }  # fmt: skip
    cloud = read_points(f"wood.{suffix}")
    assert len(cloud) == 500
    assert cloud.normals is None
    if suffix != "xyz":
        assert set(cloud.attributes["classification"]) >= {2, 5}
        assert cloud.attributes["number_of_returns"].max() > 1
    assert len(read_mesh("wood_truth.ply").attributes["classification"])
    assert Path("wood_trajectory.csv").read_text().startswith("time,x,y,z\n300000.")
    path = np.loadtxt("wood_trajectory.csv", delimiter=",", skiprows=1)
    assert path.shape[1] == 4


def test_an_object_is_any_model_and_lengths_are_its_own(run: Run) -> None:
    code, _, stderr = run(
        "simulate",
        "--scene",
        "object",
        "--shape",
        "box",
        "-n",
        "500",
        "--noise",
        "0",
        "-o",
        "b.ply",
    )
    assert code == 0
    assert "500 points of a scene: object" in stderr
    code, stdout, _ = run("compare", "b_truth.ply", "shape:box", "--json")
    assert code == 0
    assert '"genus": 0' in stdout


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--scene", "room", "--scanner", "airborne"], "choose terrestrial or handheld"),
        (["--scene", "room", "--views", "3"], "--views is for a model alone"),
        (["--scene", "room", "--pose-error", "0.1"], "--pose-error is for a model alone"),
        (["--scene", "room", "--shape", "knot"], "--shape"),
        (["--shape", "knot", "--flying", "0.1"], "--flying is for a scene"),
        (["--shape", "knot", "--scanner", "handheld"], "--scanner is for a scene"),
        (["--scene", "moon"], "terrain"),
        ([], "--shape"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    run: Run, options: list[str], words: str
) -> None:
    code, _, stderr = run("simulate", *options, "-o", "none.ply")
    assert code == 2
    assert words in stderr
    assert "Traceback" not in stderr
    assert not list(Path().iterdir())
