"""``hpcapp align``: from files to one cloud."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from stands import scan_stands, true_pose
from verbs import run_verb

from hpcapp.alignment.command import align
from hpcapp.alignment.pair import MARGIN, SLIDES
from hpcapp.alignment.pose import difference, make_pose, move
from hpcapp.alignment.sample import sample_scan
from hpcapp.cli import hpcapp
from hpcapp.geometry.points import PointCloud
from hpcapp.io import open_points, read_points, write_points
from hpcapp.io.points.point_source import Scan
from hpccomponent.errors import InputError, UsageError


def write_stands(folder: Path) -> list[Path]:
    """Write the scans of a room, with normals to the scanner, which stands at zero."""
    paths = [folder / "first.ply", folder / "second.ply"]
    for path, (points, _) in zip(paths, scan_stands(), strict=True):
        rays = -points / np.linalg.norm(points, axis=1, keepdims=True)
        cloud = PointCloud(points, rays.astype(np.float32))
        write_points(path, cloud, scans=(Scan(len(points), np.zeros(3)),))
    return paths


def test_a_room_becomes_one_cloud_and_its_poses_go_in_again(tmp_path: Path) -> None:
    paths, poses = write_stands(tmp_path), tmp_path / "poses.json"
    out = run_verb(align, *paths, "-o", tmp_path / "all.ply", "--write-poses", poses, "--json")
    report = json.loads(out)
    assert json.loads(poses.read_text()) == report
    second, moved = scan_stands()[1][0], np.array(report["poses"][str(paths[1])])
    spacing = sample_scan(second).spacing
    assert difference(moved, true_pose(), second) < 0.5 * spacing
    (pair,) = report["pairs"]
    assert pair["overlap"] > 0.7
    assert pair["residual"] < spacing
    # It is sure by more than a tenth of every limit.
    assert pair["next_worth"] < (1 - 1.1 * MARGIN) * pair["worth"]
    assert pair["slid_worth"] < 0.9 * SLIDES * pair["worth"]
    source = open_points(tmp_path / "all.ply")
    # The scanners and the normals went along: they look to their own scanner.
    scanner = source.scans[1].scanner
    assert scanner is not None
    np.testing.assert_allclose(scanner, moved[:3, 3], atol=1e-5)
    cloud = read_points(tmp_path / "all.ply")
    rows = np.flatnonzero(cloud.attributes["scan"] == 1)
    placed = cloud.positions[rows] + cloud.origin
    np.testing.assert_allclose(placed, move(moved, second), atol=1e-4)
    assert cloud.normals is not None
    rays = scanner - placed
    assert (np.einsum("ni,ni->n", cloud.normals[rows], rays) > 0).all()
    run_verb(align, *paths, "-o", tmp_path / "again.ply", "--poses", poses)
    assert (tmp_path / "again.ply").read_bytes() == (tmp_path / "all.ply").read_bytes()


class TestRefused:
    def test_one_file_has_nothing_to_be_aligned_with(self, tmp_path: Path) -> None:
        paths = write_stands(tmp_path)
        with pytest.raises(UsageError, match="one file"):
            run_verb(align, paths[0], "-o", tmp_path / "all.ply")

    @pytest.mark.slow
    def test_plains_fit_everywhere_and_nothing_is_written(self, tmp_path: Path) -> None:
        rng = np.random.default_rng(0)
        for name in ("a.xyz", "b.xyz"):
            flat = np.column_stack([rng.uniform(0, 9, (2000, 2)), rng.normal(0, 0.02, 2000)])
            np.savetxt(tmp_path / name, flat)
        with pytest.raises(InputError, match=r"b\.xyz: not to be aligned surely") as raised:
            run_verb(align, tmp_path / "a.xyz", tmp_path / "b.xyz", "-o", tmp_path / "all.ply")
        assert "--max-shift" in str(raised.value)
        assert not (tmp_path / "all.ply").exists()

    @pytest.mark.parametrize(
        ("poses", "problem"),
        [
            ({}, "no pose of"),
            ({"second.ply": np.eye(3).tolist()}, "no rigid move"),
            ({"second.ply": (2 * np.eye(4)).tolist()}, "no rigid move"),
            ({"second.ply": make_pose(np.diag([1, 1, -1]), np.zeros(3)).tolist()}, "no rigid move"),
            ({"second.ply": "east"}, "is no file of poses"),
        ],
    )
    def test_poses_that_are_none(
        self, tmp_path: Path, poses: dict[str, object], problem: str
    ) -> None:
        paths, file = write_stands(tmp_path), tmp_path / "poses.json"
        given = {str(tmp_path / name): pose for name, pose in poses.items()}
        file.write_text(json.dumps({"poses": {str(paths[0]): np.eye(4).tolist(), **given}}))
        with pytest.raises(InputError, match=problem):
            run_verb(align, *paths, "-o", tmp_path / "all.ply", "--poses", file)


def test_the_verb_is_listed() -> None:
    assert hpcapp.get_command(None, "align") is align  # type: ignore[arg-type]
