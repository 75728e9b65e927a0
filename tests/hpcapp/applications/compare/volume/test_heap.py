"""A heap of 100 m³ and a pit of 20 m³, scanned before and after: volumes within what is said."""

from __future__ import annotations

import logging
from functools import cache

import numpy as np
import pytest

import hpcapp
from hpcapp.applications.compare.volume.measure import Change, Volume
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.lab.simulate.raw.scan import RawSettings, scan_scene
from hpcapp.lab.simulate.raw.scenes import HEAP, PIT, SCENES
from hpccomponent.errors import InputError, UsageError

HEAP_AT = (24.0, 22.0)
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
        change = hpcapp.compare_epochs(*pair(noise, seed=seed))
        assert is_true(change), (seed, change)
        # of use, too: what is said is no more than a few standard deviations of what is met
        assert change.net.uncertainty < 0.7 + 12.0 * noise
        assert change.fill.area == pytest.approx(np.pi * 25.0, rel=0.7)
    # noise half as wide as a cell, 0.6 m, is as good as a second layer
    assert bool(caplog.records) == (noise == 0.3)


@pytest.mark.parametrize(
    "points", [(60_000, 5_000), (5_000, 60_000), (4_000, 4_000), (2_000, 20_000)]
)
def test_densities_may_differ(points: tuple[int, int]) -> None:
    for seed in range(3):
        change = hpcapp.compare_epochs(*pair(points=points, seed=seed))
        assert is_true(change), (seed, change)
        assert change.fill.uncertainty < 0.1 * HEAP


@pytest.mark.parametrize(
    "shift", [(0.0, 0.0, 0.03), (0.1, -0.05, 0.02), (0.3, 0.3, -0.1), (0.5, 0.0, 0.0)]
)
def test_a_shift_of_one_scan_is_found_and_is_uncertain(shift: tuple[float, float, float]) -> None:
    new, old = pair()
    still, moved = (
        hpcapp.compare_epochs(new, old),
        hpcapp.compare_epochs(new + np.array(shift), old),
    )
    assert moved.shift == pytest.approx(shift, abs=0.02)
    assert is_true(moved)
    assert moved.net.uncertainty > still.net.uncertainty
    assert moved.net.from_shift > abs(shift[2]) * 0.8 * moved.net.area


def test_who_vouches_for_the_registration_has_the_shift_counted() -> None:
    new, old = pair()
    lifted = hpcapp.compare_epochs(new + np.array([0.0, 0.0, 0.5]), old, registration=0.001)
    assert lifted.registration == 0.001
    assert lifted.net.from_shift == 0.0
    assert lifted.net.area == pytest.approx(lifted.common, rel=0.02)
    assert near(lifted.net, HEAP - PIT + 0.5 * lifted.common)
    usual, doubted = (hpcapp.compare_epochs(new, old, registration=r) for r in (0.0, 0.02))
    assert is_true(usual)
    assert doubted.fill.uncertainty > usual.fill.uncertainty + 1.0


def test_nothing_is_counted_where_one_scan_has_a_hole() -> None:
    new, old = pair()
    change = hpcapp.compare_epochs(new, old[away(old, HEAP_AT) > 7.0])
    assert near(change.cut, PIT)
    assert near(change.fill, 0.0)
    whole = hpcapp.compare_epochs(new, old)
    assert change.only_new - whole.only_new == pytest.approx(np.pi * 49.0, rel=0.1)
    assert change.common == pytest.approx(whole.common - np.pi * 49.0, rel=0.02)
    change = hpcapp.compare_epochs(new[away(new, (30.0, 8.0)) > 4.0], old)
    assert is_true(change)
    assert change.only_old - whole.only_old == pytest.approx(np.pi * 16.0, rel=0.15)


def test_nothing_that_changed_is_nothing_that_is_told() -> None:
    for seed in range(4):
        old, new = (scan("yard", 20_000, 0.03, seed + more) for more in (0, 100))
        change = hpcapp.compare_epochs(new, old)
        assert near(change.cut, 0.0)
        assert near(change.fill, 0.0)
        # of 2,500 cells half a one stands out by chance, with a ring around it now and then
        assert change.net.area <= 9.5 * change.cell**2


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_any_axis_may_point_up_and_places_may_be_far(up: str) -> None:
    turn = "zxy".index(up)
    new, old = (np.roll(points, turn, axis=1) + FAR for points in pair())
    usual = hpcapp.compare_epochs(*pair())
    change = hpcapp.compare_epochs(new, old, up=up)  # type: ignore[arg-type]
    assert change.fill.volume == pytest.approx(usual.fill.volume, rel=1e-3)
    assert change.cut.area == pytest.approx(usual.cut.area, rel=0.1)


def test_meshes_and_points_may_be_mixed() -> None:
    new, old = as_shown(truth("heap")), as_shown(truth("yard"))
    exact = hpcapp.compare_epochs(new, old)
    assert is_true(exact)
    assert exact.net.uncertainty < 0.02
    assert is_true(hpcapp.compare_epochs(pair()[0], old))
    assert is_true(hpcapp.compare_epochs(new, pair(seed=1)[1]))


def test_guesswork_of_a_mesh_is_left_out() -> None:
    new, old = truth("heap"), truth("yard")
    support = np.where(away(new.vertices, HEAP_AT) < 7.0, 9.0, 1.0)
    guessed = hpcapp.Mesh(new.vertices, new.faces, attributes={"support": support})
    change = hpcapp.compare_epochs(guessed, as_shown(old))
    assert change.fill.area == 0.0
    assert near(change.cut, PIT)
    assert change.only_old == pytest.approx(np.pi * 49.0, rel=0.1)


def test_several_heights_over_one_place_are_named(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "hpcapp")
    for scene in ("forest", "town"):
        points = scan(scene, 40_000, 0.03, 0)
        hpcapp.compare_epochs(points[::2], points[1::2])
        assert "differ by more than a cell is wide" in caplog.records.pop().getMessage()


def test_what_cannot_be_compared_is_refused() -> None:
    new, old = pair()
    with pytest.raises(InputError, match="in common"):
        hpcapp.compare_epochs(new + np.array([100.0, 0.0, 0.0]), old)
    with pytest.raises(UsageError, match=r"cells 0\.0001 wide"):
        hpcapp.compare_epochs(new, old, cell=1e-4)
    with pytest.raises(UsageError, match="up is 'w'"):
        hpcapp.compare_epochs(new, old, up="w")  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="cell"):
        hpcapp.compare_epochs(new, old, cell=0.0)
    with pytest.raises(UsageError, match="registration"):
        hpcapp.compare_epochs(new, old, registration=-1.0)
    with pytest.raises(UsageError, match="is no scan"):
        hpcapp.compare_epochs("shape:knot", old)
