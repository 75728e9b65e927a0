"""Pixels tell that a camera was at zero, nothing else does, and layers of depth are smoothed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hpcapp
from hpcapp.applications.surface.scale import depth_image
from hpcapp.applications.surface.scale.depth_image import SHEETS, has_pixels, smooth_steps
from hpcapp.geometry.points import FloatArray


def _depth_image(axes: list[int]) -> FloatArray:
    """What a camera of 160 x 120 pixels sees of a wavy wall."""
    columns, rows = (axis.ravel() for axis in np.meshgrid(np.arange(160.0), np.arange(120.0)))
    across = np.stack([columns - 79.5, rows - 59.5, np.full(len(rows), 150.0)], axis=1) / 150.0
    depth = 2.0 + 0.3 * np.sin(0.05 * columns) + 0.2 * np.cos(0.07 * rows)
    depth += np.random.default_rng(0).normal(0.0, 0.004, len(depth))
    image: FloatArray = (across * depth[:, None])[:, axes]
    return image.astype(np.float32).astype(np.float64)


@pytest.mark.parametrize("axes", [[0, 1, 2], [2, 0, 1]])
@pytest.mark.parametrize("every", [1, 3])
def test_a_depth_image_shows_its_pixels(axes: list[int], every: int) -> None:
    image = _depth_image(axes)
    for some in (image, -image, 1000.0 * image):
        assert has_pixels(some[::every])
    shuffled = np.random.default_rng(1).permutation(image)
    assert has_pixels(shuffled[:3_000])


def test_whole_millimetres_hide_no_pixels() -> None:
    assert has_pixels(np.rint(1000.0 * _depth_image([0, 1, 2])))


def test_a_wall_behind_hides_no_pixels() -> None:
    """Most columns are as even in space as in the image; the others are in the image alone."""
    columns, rows = (axis.ravel() for axis in np.meshgrid(np.arange(160.0), np.arange(120.0)))
    depth = np.where(np.hypot(columns - 80.0, rows - 60.0) < 40.0, 1.1 + 0.001 * columns, 1.5)
    across = np.stack([columns - 79.5, rows - 59.5, np.full(len(rows), 150.0)], axis=1) / 150.0
    assert has_pixels(np.rint(1000.0 * across * depth[:, None]))


def test_what_was_moved_away_from_its_camera_shows_none() -> None:
    image = _depth_image([0, 1, 2])
    assert not has_pixels(image + np.array([0.1, 0.0, 0.0]))
    assert not has_pixels(image - np.array([0.0, 0.0, 2.0]))  # the camera is among the points


def test_points_on_a_lattice_in_space_are_no_pixels() -> None:
    steps = np.arange(80.0)
    x, y = (axis.ravel() for axis in np.meshgrid(steps, steps))
    for height in (0.0, 1.0):
        relief = 150.0 + height * np.sin(0.3 * x) * np.cos(0.2 * y)
        assert not has_pixels(np.stack([x - 40.0, y - 40.0, relief], axis=1))


def test_scattered_points_over_zero_are_no_pixels() -> None:
    random = np.random.default_rng(2)
    ground = random.uniform(-50.0, 50.0, (9_000, 3))
    ground[:, 2] = 150.0 + 3.0 * np.sin(0.1 * ground[:, 0])
    assert not has_pixels(ground)


def _layered_image(spacings: float) -> tuple[FloatArray, FloatArray, float]:
    """The depths of a wavy wall in layers so many spacings apart, and without; and their step.

    Which of two layers a pixel is in hangs on its noise, as of a camera that matches images.
    """
    columns, rows = (axis.ravel() for axis in np.meshgrid(np.arange(160.0), np.arange(120.0)))
    rays = np.stack([columns - 79.5, rows - 59.5, np.full(len(rows), 150.0)], axis=1) / 150.0
    depth = 4.0 + 0.5 * np.sin(0.04 * columns) + 0.4 * np.cos(0.05 * rows)
    step = spacings / 150.0 / 4.0
    layers = np.rint(1.0 / depth / step + np.random.default_rng(3).normal(0.0, 0.4, len(depth)))
    return rays / (layers * step)[:, None], rays * depth[:, None], step


def _share_behind(positions: FloatArray) -> float:
    """Return the share of the area of the mesh whose outer side looks away from the camera."""
    mesh = hpcapp.reconstruct(positions, executor="serial")
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    return float(areas[np.einsum("ij,ij->i", normals, corners[:, 0]) > 0.0].sum() / areas.sum())


@pytest.mark.parametrize(("spacings", "least"), [(2.0, 0.1), (3.0, 0.3)])
def test_layers_that_lie_far_apart_are_one_sheet(
    spacings: float, least: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    layered = _layered_image(spacings)[0]
    assert _share_behind(layered) < 0.01
    monkeypatch.setattr(depth_image, "SHEETS", 10.0)
    assert _share_behind(layered) > least


def test_layers_are_smoothed_from_where_they_become_sheets(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where they stay as they are, few faces look away with 1.5 spacings, and many with 2."""
    assert (
        smooth_steps(_layered_image(0.8 * SHEETS)[0])[1]
        < smooth_steps(_layered_image(SHEETS * 1.2)[0])[1]
    )
    monkeypatch.setattr(depth_image, "SHEETS", 10.0)
    assert _share_behind(_layered_image(SHEETS)[0]) < 0.1 < _share_behind(_layered_image(2.0)[0])


def test_a_depth_comes_nearer_to_the_truth_and_stays_in_its_layer() -> None:
    layered, true, step = _layered_image(3.0)
    smoothed, moved = smooth_steps(layered)
    assert moved > 0.9 * len(layered)
    inverse = 1.0 / smoothed[:, 2]
    assert np.abs(inverse - 1.0 / layered[:, 2]).max() < 0.501 * step
    assert smoothed[:, :2] * inverse[:, None] == pytest.approx(layered[:, :2] / layered[:, 2:])
    before, after = (np.abs(some[:, 2] - true[:, 2]).mean() for some in (layered, smoothed))
    assert after < 0.6 * before


@pytest.mark.parametrize("digits", [3, 4])
def test_layers_in_whole_millimetres_are_layers_too(digits: int) -> None:
    """From one metre to nine, where a camera has them a millimetre and 20 centimetres apart."""
    columns, rows = (axis.ravel() for axis in np.meshgrid(np.arange(320.0), np.arange(240.0)))
    rays = np.stack([columns - 159.5, rows - 119.5, np.full(len(rows), 300.0)], axis=1) / 300.0
    true, step = 1.0 + 8.0 * columns / 319.0, 0.0029
    noise = np.random.default_rng(5).normal(0.0, 0.4, len(true))
    depth = (1.0 / (np.rint(1.0 / true / step + noise) * step)).round(digits)
    smoothed, moved = smooth_steps(rays * depth[:, None])
    assert moved > 0.8 * len(true)
    is_far = true > 3.0
    before, after = (np.abs(some - true)[is_far].mean() for some in (depth, smoothed[:, 2]))
    assert after < 0.6 * before


def test_nothing_is_smoothed_over_an_edge() -> None:
    layered, _, step = _layered_image(3.0)
    is_front = np.abs(layered[:, 0] / layered[:, 2]) < 0.2
    layered[is_front] /= (1.0 + 10.0 * step * layered[is_front, 2])[:, None]
    for side in (is_front, ~is_front):
        alone = layered[side]
        assert np.abs(smooth_steps(layered)[0][side] - alone).max() < 0.2


@pytest.mark.parametrize("name", ["fine layers", "stairs", "no camera", "noise"])
def test_other_points_stay(name: str) -> None:
    layered, true, _ = _layered_image(3.0)
    given = {
        "fine layers": _layered_image(0.5)[0],
        "stairs": true / true[:, 2:] * (np.rint(8.0 * true[:, 2:]) / 8.0),
        "no camera": layered + np.array([0.0, 0.0, 1.0]),
        "noise": true * np.random.default_rng(4).normal(1.0, 0.01, (len(true), 1)),
    }[name]
    assert smooth_steps(given)[0] is given


def test_layers_are_smoothed_alike_in_memory_and_in_a_folder(tmp_path: Path) -> None:
    layered = _layered_image(2.5)[0]
    layered[7] = np.nan
    np.savetxt(tmp_path / "frame.xyz", layered, fmt="%.7f")
    given = tmp_path / "frame.xyz"
    whole = hpcapp.reconstruct(given, executor="serial")
    parts = hpcapp.reconstruct(given, executor="serial", temp_dir=tmp_path)
    assert whole.facts["smoothed_depths"] == parts.facts["smoothed_depths"] > 0.9 * len(layered)
    assert np.array_equal(whole.vertices, parts.vertices)
    assert np.array_equal(whole.faces, parts.faces)
