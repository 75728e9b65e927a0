"""The bare ground: which way it is found, what is said, and what is refused."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from on_earth import put_on_earth

import hpcapp as package
from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.cli import hpcapp
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import open_points, read_mesh, read_points, write_points
from hpcapp.io.points.mesh_points import slice_cloud
from hpcapp.parts.crop import make_crop, parse_crop
from hpcapp.parts.ground import take_ground
from hpcapp.progress import Progress
from hpccomponent.errors import InputError, MissingLibraryError, UsageError

HOUSE = (12.0, 20.0, 8.0, 14.0)


def rise(places: FloatArray) -> FloatArray:
    """The true ground."""
    heights: FloatArray = 0.8 * np.sin(places[:, 0] / 6.0) + 0.05 * places[:, 1]
    return heights


@pytest.fixture(scope="module")
def yard() -> PointCloud:
    """A yard with a house, a tree and wrong returns below the ground, 40 by 24 metres."""
    random = np.random.default_rng(3)
    places = random.random((12_000, 3)) * (40.0, 24.0, 0.0)
    places[:, 2] = rise(places) + random.normal(0.0, 0.01, len(places))
    x, y = places[:, :2].T
    is_house = (x > HOUSE[0]) & (x < HOUSE[1]) & (y > HOUSE[2]) & (y < HOUSE[3])
    places[is_house, 2] = 5.0
    is_tree = np.hypot(x - 30.0, y - 8.0) < 3.0
    is_tree &= random.random(len(places)) < 0.6
    places[is_tree, 2] += random.uniform(2.0, 7.0, int(is_tree.sum()))
    places[::1000, 2] -= random.uniform(3.0, 30.0, len(places[::1000]))
    truth = np.where(is_house, 6, np.where(is_tree, 5, 2)).astype(np.uint8)
    truth[::1000] = 7
    return PointCloud(places, attributes={"truth": truth})


def find_ground(
    cloud: PointCloud, unit: str | None = None, height_unit: str | None = None
) -> np.ndarray:
    made = slice_cloud(Path("yard"), "made", cloud)
    source = replace(made, unit=unit, height_unit=height_unit)
    parts = list(take_ground(source).chunks(1000))
    found: np.ndarray = np.concatenate([part.attributes["truth"] for part in parts])
    return found


def test_a_cloth_finds_the_ground_between_a_house_and_a_tree(
    yard: PointCloud, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    with caplog.at_level(logging.INFO, "hpcapp"):
        found = find_ground(yard)
    truth = yard.attributes["truth"]
    assert (found == 2).mean() > 0.999
    assert (found == 2).sum() > 0.99 * (truth == 2).sum()
    left_out = len(truth) - len(found)
    assert f"ground: by cloth simulation; {left_out} of 12000 points left out" in caplog.text
    assert capfd.readouterr().out == ""  # the library would print


def test_feet_and_heights_of_their_own_are_lengths_like_others(yard: PointCloud) -> None:
    found = find_ground(yard)
    feet = replace(yard, positions=yard.positions / 0.3048 + (2e6, 5e5, 0.0))
    assert abs(len(find_ground(feet, unit="ft")) - len(found)) < 20
    both = replace(feet, positions=feet.positions * (1.0, 1.0, 0.3048))
    assert abs(len(find_ground(both, unit="ft", height_unit="m")) - len(found)) < 20
    with pytest.raises(InputError, match="its coordinates are degrees"):
        find_ground(yard, unit="degree")


@pytest.mark.parametrize("latitude", [48.0, -35.0])
def test_from_the_centre_of_the_earth_the_ground_is_what_is_lowest_along_up(
    yard: PointCloud, tmp_path: Path, latitude: float
) -> None:
    truth, path = yard.attributes["truth"], tmp_path / "yard.ply"
    earth = put_on_earth(yard, latitude)
    write_points(path, earth, "EPSG:4978")
    parts = make_crop(ground=True).take(open_points(path)).chunks(1000)
    for found in (
        np.concatenate([part.attributes["truth"] for part in parts]),
        find_ground(earth),
    ):
        assert (found == 2).mean() > 0.999
        assert (found == 2).sum() > 0.99 * (truth == 2).sum()


def test_class_2_is_the_ground_where_there_is_some(
    yard: PointCloud, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hpcapp.extras.find_spec", lambda name: None)
    path, output = tmp_path / "yard.las", tmp_path / "ground.ply"
    write_points(path, replace(yard, attributes={"classification": yard.attributes["truth"]}))
    run = CliRunner().invoke(hpcapp, ["convert", str(path), "-o", str(output), "--ground"])
    assert run.exit_code == 0
    assert set(read_points(output).attributes["classification"]) == {2}
    assert "not_ground" not in run.output
    with pytest.raises(MissingLibraryError, match="no class 2"):
        list(take_ground(slice_cloud(Path("yard"), "made", yard)).chunks(1000))


def test_two_passes_look_for_it_once(
    yard: PointCloud, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_points(tmp_path / "yard.ply", yard)
    counts = []
    with caplog.at_level(logging.INFO, "hpcapp"):
        for _ in range(2):
            source = make_crop(ground=True).take(open_points(tmp_path / "yard.ply"))
            counts.append(sum(map(len, source.chunks(1000))))
            assert source.findings.dropped == {"not_ground": 12_000 - counts[0]}
            assert not source.findings.lines()
    assert counts[0] == counts[1]
    assert caplog.text.count("ground: by cloth") == 1


@pytest.mark.parametrize("fill", ["auto", "25"])
def test_the_mesh_is_open_below_a_house_unless_it_is_to_be_filled(
    yard: PointCloud, fill: str
) -> None:
    mesh = package.reconstruct(
        yard, ground=True, fill_holes=fill, executor="serial", attributes="none"
    )
    vertices = np.array(mesh.vertices)
    assert np.abs(vertices[:, 2] - rise(vertices)).max() < 0.25
    x, y = vertices[:, :2].T
    below = (x > HOUSE[0] + 2) & (x < HOUSE[1] - 2) & (y > HOUSE[2] + 2) & (y < HOUSE[3] - 2)
    assert below.any() == (fill == "25")
    assert not mesh.is_watertight


def test_in_memory_and_in_a_folder_the_ground_is_the_same(yard: PointCloud, tmp_path: Path) -> None:
    points = tmp_path / "yard.ply"
    write_points(points, yard)
    made = []
    for number, memory in enumerate((None, 3e8)):
        output = tmp_path / f"{number}.ply"
        job = JobSettings(
            points=points, output=str(output), crop=make_crop((0, 0, -9, 30, 24, 9), ground=True),
            backend="serial", max_memory=memory,
            temp_dir=None if memory is None else str(tmp_path / "points"),
        )  # fmt: skip
        report = run_job(job.for_ground(), Progress())
        assert report["dropped"]["not_ground"] > 500
        made.append(output.read_bytes())
    assert made[0] == made[1]
    assert read_mesh(tmp_path / "0.ply").vertices[:, 0].max() == pytest.approx(30.0)
    assert check_mesh(read_mesh(tmp_path / "0.ply")).boundaries == 2  # with that below the house


def test_what_is_too_large_or_holds_none_is_one_line(yard: PointCloud) -> None:
    wide = replace(yard, positions=yard.positions * (300.0, 300.0, 1.0))
    with pytest.raises(InputError, match="too large to find the ground by a cloth: 8") as found:
        find_ground(wide)
    assert "class 2 has no limit" in found.value.advice
    nowhere = replace(yard, positions=np.full_like(yard.positions, np.nan))
    with pytest.raises(InputError, match="no ground in it"):
        find_ground(nowhere)
    with pytest.raises(UsageError, match="classes and ground exclude each other"):
        parse_crop(classes="2", ground=True)


def test_few_points_are_no_trouble() -> None:
    for count in (1, 3, 12):
        few = PointCloud(
            np.random.default_rng(0).random((count, 3)) * (9, 9, 0.1),
            attributes={"truth": np.full(count, 2)},
        )
        assert len(find_ground(few))
