"""A heap of 100 m³ and a pit of 20 m³, scanned before and after: volumes within what is said."""

from __future__ import annotations

import logging
from functools import cache
from typing import Any

import numpy as np
import pytest

import hpcapp
from hpcapp.applications.compare.volume.measure import Change, Volume
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.lab.simulate.raw.scan import RawSettings, scan_scene
from hpcapp.lab.simulate.raw.scenes import HEAP, PIT, SCENES
from hpcapp.terrain.epoch import FEW_LAYERS
from hpccomponent.errors import InputError, UsageError

HEAP_AT, HEAP_RADIUS = (24.0, 22.0), 5.0
FAR = np.array([5_400_000.0, 400_000.0, 7.0])


@cache
def scan(scene: str, points: int, noise: float, seed: int) -> FloatArray:
    settings = RawSettings(points=points, noise=noise, seed=seed)
    return scan_scene(scene, "airborne", settings).cloud.positions


@cache
def truth(scene: str) -> Mesh:
    return SCENES[scene](np.random.default_rng(0), "").truth


def as_shown(mesh: Mesh) -> hpcapp.Mesh:
    return hpcapp.Mesh(mesh.vertices, mesh.faces)


def pair(
    noise: float = 0.03, points: tuple[int, int] = (20_000, 20_000), seed: int = 0
) -> tuple[FloatArray, FloatArray]:
    new = scan("heap", points[0], noise, 2 * seed)
    return new, scan("yard", points[1], noise, 2 * seed + 1)


def measure(new: object, old: object, **options: Any) -> Change:
    change = hpcapp.compare_epochs(new, old, **options)  # type: ignore[arg-type]
    assert isinstance(change, Change)
    return change


def near(part: Volume, volume: float) -> bool:
    return abs(part.volume - volume) <= part.uncertainty


def is_true(change: Change) -> bool:
    parts = ((change.cut, PIT), (change.fill, HEAP), (change.net, HEAP - PIT))
    return all(near(part, volume) for part, volume in parts)


def away(points: FloatArray, place: tuple[float, float]) -> FloatArray:
    distance: FloatArray = np.hypot(*(points[:, :2] - place).T)
    return distance


def test_the_truth_of_both_scenes_differs_by_heap_and_pit() -> None:
    rise = truth("heap").vertices[:, 2] - truth("yard").vertices[:, 2]
    assert 0.25 * rise[rise > 0.0].sum() == pytest.approx(HEAP)
    assert 0.25 * rise[rise < 0.0].sum() == pytest.approx(-PIT)


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.01, 0.03, 0.1, 0.3])
def test_volumes_are_within_what_is_said(noise: float, caplog: pytest.LogCaptureFixture) -> None:
    for seed in range(4):
        change = measure(*pair(noise, seed=seed))
        assert is_true(change), (seed, change)
        # of use, too: what is said is no more than a few standard deviations of what is met
        assert change.net.uncertainty < 1.0 + 16.0 * noise
        # a plane takes in one cell around, and rings are a cell wide: the rim is three at most
        rim = np.sqrt(change.fill.area / np.pi) - HEAP_RADIUS
        assert -0.1 * HEAP_RADIUS < rim < 3.0 * change.cell
    # noise half as wide as a cell, 0.6 m, is as good as a second layer
    assert bool(caplog.records) == (noise == 0.3)


@pytest.mark.parametrize(
    "points", [(60_000, 5_000), (5_000, 60_000), (4_000, 4_000), (2_000, 20_000)]
)
def test_densities_may_differ(points: tuple[int, int]) -> None:
    for seed in range(3):
        change = measure(*pair(points=points, seed=seed))
        assert is_true(change), (seed, change)
        assert change.fill.uncertainty < 0.1 * HEAP


def raise_ground(points: FloatArray, share: float, by: float) -> FloatArray:
    """Return points of which those in the west are higher."""
    is_raised = points[:, 0] < share * 60.0
    return points + np.outer(is_raised, [0.0, 0.0, by])


def make_plain(count: int, seed: int, noise: float = 0.02, size: float = 60.0) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(0.0, size, (count, 2)), rng.normal(0.0, noise, count)])


@pytest.mark.parametrize("count", [700, 4_000, 20_000])
def test_the_common_area_is_that_of_the_field(count: int) -> None:
    change = measure(make_plain(count, 0), make_plain(count, 1))
    spacing = 60.0 / count**0.5
    assert change.common == pytest.approx(3600.0, abs=0.15 * spacing * 4.0 * 60.0)


@pytest.mark.parametrize("share", [0.2, 0.55, 0.75, 1.0])
@pytest.mark.parametrize("by", [1.0, -1.0, 0.1])
def test_ground_that_rose_is_told_whole(share: float, by: float) -> None:
    new, old = raise_ground(make_plain(3_600, 0), share, by), make_plain(3_600, 1)
    change = measure(new, old)
    part, other = (change.fill, change.cut) if by > 0.0 else (change.cut, change.fill)
    assert near(part, share * 3600.0 * abs(by))
    assert near(other, 0.0)
    # all of it may be a shift, and that is in what is said; with ground that stayed it is none
    whole = pytest.approx(3600.0 * abs(by), rel=0.05)
    assert (part.from_shift == whole) == (share == 1.0)
    assert part.is_shift == (share == 1.0)
    assert part.volume == pytest.approx(share * 3600.0 * abs(by), rel=0.05)


def test_who_is_sure_of_the_registration_has_ground_that_rose_told() -> None:
    new, old = raise_ground(make_plain(3_600, 0), 1.0, 1.0), make_plain(3_600, 1)
    change = measure(new, old, registration=0.01)
    assert change.fill.is_significant
    assert near(change.fill, 3600.0)


def test_a_heap_is_told_where_points_are_sparse() -> None:
    fills = []
    for seed in range(8):
        new, old = (make_plain(700, 2 * seed + k, noise=0.05) for k in (0, 1))
        new[:, 2] += 1.5 * np.clip(1.0 - away(new, (25.0, 30.0)) / 8.0, 0.0, None)
        fills.append(measure(new, old).fill)
    assert all(fill.is_significant for fill in fills)
    assert sum(near(fill, np.pi * 8.0**2 * 1.5 / 3.0) for fill in fills) >= 7


@pytest.mark.parametrize(
    "shift", [(0.0, 0.0, 0.03), (0.1, -0.05, 0.02), (0.3, 0.3, -0.1), (0.5, 0.0, 0.0)]
)
def test_a_shift_of_one_scan_is_found_and_is_uncertain(shift: tuple[float, float, float]) -> None:
    new, old = pair()
    still, moved = (
        measure(new, old),
        measure(new + np.array(shift), old),
    )
    assert moved.shift == pytest.approx(shift, abs=0.02)
    assert is_true(moved)
    assert moved.net.uncertainty > still.net.uncertainty
    assert moved.net.from_shift > abs(shift[2]) * 0.7 * moved.net.area


def test_who_vouches_for_the_registration_has_the_shift_counted() -> None:
    new, old = pair()
    lifted = measure(new + np.array([0.0, 0.0, 0.5]), old, registration=0.001)
    assert lifted.registration == 0.001
    assert lifted.net.from_shift == 0.0
    assert lifted.net.area == pytest.approx(lifted.common, rel=0.02)
    assert near(lifted.net, HEAP - PIT + 0.5 * lifted.common)
    usual, doubted = (measure(new, old, registration=r) for r in (0.0, 0.02))
    assert is_true(usual)
    assert doubted.fill.uncertainty > usual.fill.uncertainty + 1.0


def test_nothing_is_counted_where_one_scan_has_a_hole() -> None:
    new, old = pair()
    change = measure(new, old[away(old, HEAP_AT) > 7.0])
    assert near(change.cut, PIT)
    assert near(change.fill, 0.0)
    whole = measure(new, old)
    assert change.only_new - whole.only_new == pytest.approx(np.pi * 49.0, rel=0.1)
    assert change.common == pytest.approx(whole.common - np.pi * 49.0, rel=0.02)
    change = measure(new[away(new, (30.0, 8.0)) > 4.0], old)
    assert is_true(change)
    assert change.only_old - whole.only_old == pytest.approx(np.pi * 16.0, rel=0.15)


def test_nothing_that_changed_is_nothing_that_is_told() -> None:
    told = 0
    for seed in range(20):
        old, new = (scan("yard", 5_000, 0.03, seed + more) for more in (0, 100))
        change = measure(new, old)
        told += change.net.area > 0.0
    assert told <= 2  # 95 % of them are to tell nothing


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_any_axis_may_point_up_and_places_may_be_far(up: str) -> None:
    turn = "zxy".index(up)
    new, old = (np.roll(points, turn, axis=1) + FAR for points in pair())
    usual = measure(*pair())
    change = measure(new, old, up=up)
    assert change.fill.volume == pytest.approx(usual.fill.volume, rel=1e-3)
    assert change.cut.area == pytest.approx(usual.cut.area, rel=0.1)


def test_meshes_and_points_may_be_mixed() -> None:
    new, old = as_shown(truth("heap")), as_shown(truth("yard"))
    exact = measure(new, old)
    assert is_true(exact)
    assert exact.net.uncertainty < 0.02
    assert is_true(measure(pair()[0], old))
    assert is_true(measure(new, pair(seed=1)[1]))


def test_meshes_of_scans_tell_noise_by_what_agrees() -> None:
    old, same, new = (hpcapp.reconstruct(make_plain(3_600, k)) for k in (0, 1, 2))
    raised = raise_ground(new.vertices, 0.5, 0.5)
    change = measure(hpcapp.Mesh(raised, new.faces), old)
    assert near(change.fill, 900.0)
    assert change.fill.uncertainty < 90.0
    assert near(measure(same, old).net, 0.0)


def test_guesswork_of_a_mesh_is_left_out() -> None:
    new, old = truth("heap"), truth("yard")
    support = np.where(away(new.vertices, HEAP_AT) < 7.0, 9.0, 1.0)
    guessed = hpcapp.Mesh(new.vertices, new.faces, attributes={"support": support})
    change = measure(guessed, as_shown(old))
    assert change.fill.area == 0.0
    assert near(change.cut, PIT)
    assert change.only_old == pytest.approx(np.pi * 49.0, rel=0.1)


def test_several_heights_over_one_place_are_named(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "hpcapp")
    for scene in ("forest", "town"):
        points = scan(scene, 40_000, 0.03, 0)
        change = measure(points[::2], points[1::2])
        assert change.layered > 2.0 * FEW_LAYERS * change.common
        assert "differ by more than a cell is wide" in caplog.records.pop().getMessage()


def test_bare_ground_has_one_height() -> None:
    change = measure(*pair())
    assert change.layered < 0.5 * FEW_LAYERS * change.common


def test_cells_hold_four_points_where_they_are_sparse() -> None:
    """Half or double of it would be another width."""
    assert measure(*pair()).cell == pytest.approx(np.sqrt(4.0 * 1600.0 / 20_000), rel=0.2)


def test_what_cannot_be_compared_is_refused() -> None:
    new, old = pair()
    with pytest.raises(InputError, match="in common"):
        measure(new + np.array([100.0, 0.0, 0.0]), old)
    with pytest.raises(UsageError, match=r"cells 0\.0001 wide"):
        measure(new, old, cell=1e-4)
    with pytest.raises(UsageError, match="up is 'w'"):
        measure(new, old, up="w")
    with pytest.raises(UsageError, match="cell"):
        measure(new, old, cell=0.0)
    with pytest.raises(UsageError, match="registration"):
        measure(new, old, registration=-1.0)
    with pytest.raises(UsageError, match="is no scan"):
        measure("shape:knot", old)
