from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from directions import random_directions
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from shared_data import shared

from hpcapp.applications.surface.paper.kdtree import (
    SplitRule,
    partition_by_count,
    partition_by_rule,
)
from hpcapp.geometry.points import FloatArray
from hpccomponent.errors import InputError, UsageError

ROOTS = ("cube", "box", "tight")


def read_bunny(name: str) -> tuple[FloatArray, FloatArray]:
    content = shared(name).read_bytes()
    start = content.index(b"end_header\n") + len(b"end_header\n")
    rows = np.frombuffer(content[start:], "<f4").reshape(-1, 6).astype(float)
    return rows[:, :3], rows[:, 3:]


def scatter(rng: np.random.Generator, n: int) -> tuple[FloatArray, FloatArray]:
    normals = random_directions(n, rng)
    return rng.normal(size=(n, 3)) * (3.0, 2.0, 1.0) + 50.0, normals


@pytest.mark.parametrize(
    ("cone", "root", "limits", "counts"),
    [
        ("paper", "cube", (20_000, 10_000, 1_000, 100, None), (240, 240, 254, 683, 240)),
        ("complement", "tight", (20_000, 10_000, 1_000, 100, None), (2375, 2375, 2375, 2450, 2375)),
        ("complement", "cube", (20_000, 100, None), (2488, 2556, 2488)),
        ("none", "cube", (20_000, 10_000, 1_000, 100), (3, 7, 64, 582)),
    ],
)
def test_bunny_has_the_papers_counts(
    cone: str, root: str, limits: tuple[int | None, ...], counts: tuple[int, ...]
) -> None:
    positions, normals = read_bunny("bunny_35947.ply")
    found = tuple(
        len(partition_by_rule(positions, normals, SplitRule(0.1, cone, limit), root))
        for limit in limits
    )
    assert found == counts


def test_large_bunny() -> None:
    positions, normals = read_bunny("bunny_263256.ply")
    assert len(partition_by_rule(positions, normals, SplitRule(0.1))) == 1661
    assert len(partition_by_count(positions, 240)) == 240


# Few distinct coordinates: midplanes, ties between axes and coincident points come up all the time.
coordinates = st.one_of(
    st.integers(-4, 4).map(float),
    st.integers(-(2**20), 2**20).map(lambda i: i / 1024),
    st.integers(0, 4).map(lambda i: 1.0 + i * 2.0**-52),
)
clouds = st.integers(1, 40).flatmap(
    lambda n: st.tuples(
        arrays(float, (n, 3), elements=coordinates),
        arrays(float, (n, 3), elements=st.sampled_from([-1.0, 0.0, 1.0])),
    )
)


@settings(max_examples=60, deadline=None)
@given(clouds, st.sampled_from(ROOTS), st.sampled_from([1, 3, None]), st.floats(0.0, 1.0))
def test_patches_hold_every_point_once_within_limits(
    cloud: tuple[FloatArray, FloatArray], root: str, max_points: int | None, delta: float
) -> None:
    positions, normals = cloud
    rule = SplitRule(delta, "paper", max_points)
    patches = partition_by_rule(positions, normals, rule, root)

    assert sorted(patches.order) == list(range(len(positions)))
    assert patches.offsets[0] == 0
    assert patches.offsets[-1] == len(positions)
    for i in range(len(patches)):
        members = patches.order[patches.offsets[i] : patches.offsets[i + 1]]
        assert len(members) > 0
        assert (np.diff(members) > 0).all()
        local = positions[members]
        assert (local >= patches.box_low[i]).all()
        assert (local <= patches.box_high[i]).all()
        if (local == local[0]).all():
            continue  # nothing can separate these
        assert max_points is None or len(members) <= max_points
        mean = normals[members].sum(axis=0)
        assert np.linalg.norm(mean) > 0.0
        cosines = normals[members] @ (mean / np.linalg.norm(mean))
        assert cosines.min() > rule.limit - 1e-12


@settings(max_examples=60, deadline=None)
@given(clouds, st.sampled_from(ROOTS), st.data())
def test_as_many_patches_as_asked_for(
    cloud: tuple[FloatArray, FloatArray], root: str, draw: st.DataObject
) -> None:
    positions, _ = cloud
    distinct = len(np.unique(positions + 0.0, axis=0))
    wanted = draw.draw(st.integers(1, distinct))
    patches = partition_by_count(positions, wanted, root)
    assert len(patches) == wanted
    assert sorted(patches.order) == list(range(len(positions)))
    assert (np.diff(patches.offsets) > 0).all()
    with pytest.raises(UsageError, match=f"ask for {distinct} or fewer"):
        partition_by_count(positions, distinct + 1, root)


@pytest.mark.parametrize("root", ROOTS)
def test_inner_boxes_do_not_overlap(root: str) -> None:
    positions, normals = scatter(np.random.default_rng(1), 300)
    patches = partition_by_rule(positions, normals, SplitRule(0.3, "none", 20), root)
    low = np.maximum(patches.box_low[:, None], patches.box_low[None])
    high = np.minimum(patches.box_high[:, None], patches.box_high[None])
    shared = np.clip(high - low, 0.0, None).prod(axis=2)
    assert shared[~np.eye(len(patches), dtype=bool)].max() == 0.0


def test_count_splits_the_fullest_box_first() -> None:
    positions, _ = scatter(np.random.default_rng(2), 500)
    for n in range(1, 30):
        fewer, more = partition_by_count(positions, n), partition_by_count(positions, n + 1)
        counts, later = np.diff(fewer.offsets), np.diff(more.offsets)
        # All but the fullest are still there, and no piece of it is larger than it was.
        assert np.isin(np.sort(counts)[:-1], later).all()
        assert later.max() <= counts.max()


def test_points_on_the_midplane_go_to_the_low_side_of_the_first_of_equal_axes() -> None:
    corners = np.array([[x, y, z] for x in (0.0, 2.0) for y in (0.0, 2.0) for z in (0.0, 2.0)])
    positions = np.vstack([corners, [[1.0, 2.0, 2.0]]])
    patches = partition_by_count(positions, 2)
    assert patches.order.tolist() == [0, 1, 2, 3, 8, 4, 5, 6, 7]
    assert patches.box_high[0].tolist() == [1.0, 2.0, 2.0]


def test_opposed_normals_at_one_place_make_one_patch() -> None:
    positions = np.full((2, 3), 0.1)
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    patches = partition_by_rule(positions, normals, SplitRule(0.1, "paper", 1))
    assert len(patches) == 1
    assert patches.scales.tolist() == [1.0]


@pytest.mark.parametrize("root", ROOTS)
def test_neighbouring_floats_come_apart(root: str) -> None:
    positions = np.array([[1.0, 1.0, 1.0], [np.nextafter(1.0, 2.0), 1.0, 1.0], [9.0, 1.0, 1.0]])
    normals = np.tile([0.0, 0.0, 1.0], (3, 1))
    assert len(partition_by_rule(positions, normals, SplitRule(0.1, "none", 1), root)) == 3


@pytest.mark.parametrize("root", ROOTS)
@pytest.mark.parametrize("far", [1.0, 1e-300, 5e-324])
def test_the_smallest_distances_end_the_splitting(root: str, far: float) -> None:
    positions = np.array([[0.0, 0.0, 0.0], [0.0, 5e-324, 0.0], [far, far, far]])
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    patches = partition_by_rule(positions, normals, SplitRule(0.1, "paper", 1), root)
    assert sorted(patches.order) == [0, 1, 2]


def test_patch_coordinates_reach_from_minus_one_to_one() -> None:
    positions, normals = scatter(np.random.default_rng(3), 1000)
    patches = partition_by_rule(positions, normals, SplitRule(0.1, "none", 50), "box")
    owner = np.repeat(np.arange(len(patches)), np.diff(patches.offsets))
    local = (positions[patches.order] - patches.centers[owner]) / patches.scales[owner, None]
    assert np.abs(local).max() <= 1.0 + 1e-12


def test_moved_and_scaled_cloud_has_the_same_patches() -> None:
    positions, normals = scatter(np.random.default_rng(4), 500)
    rule = SplitRule(0.2, "paper", 40)
    there = partition_by_rule(positions, normals, rule)
    here = partition_by_rule(8.0 * positions - 32.0, normals, rule)
    assert np.array_equal(there.order, here.order)
    assert np.array_equal(there.offsets, here.offsets)
    assert np.allclose(8.0 * there.box_low - 32.0, here.box_low)


@pytest.mark.parametrize(
    ("positions", "normals", "named"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3)), "no point"),
        (np.zeros((2, 3)), np.zeros((3, 3)), "shape"),
        (np.full((2, 3), np.nan), np.zeros((2, 3)), "NaN"),
    ],
)
def test_bad_arrays_are_named(positions: FloatArray, normals: FloatArray, named: str) -> None:
    with pytest.raises(InputError, match=named):
        partition_by_rule(positions, normals, SplitRule())


def test_bad_options_are_named() -> None:
    with pytest.raises(UsageError, match="root"):
        partition_by_count(np.zeros((1, 3)), 1, "sphere")
    with pytest.raises(UsageError, match="0 patches"):
        partition_by_count(np.zeros((1, 3)), 0)


def test_delta_is_read_by_the_cone() -> None:
    assert SplitRule(0.1, "paper").limit == 0.1
    assert SplitRule(0.1, "complement").limit == pytest.approx(0.9)
    assert SplitRule(1.0, "none").limit < -1.0  # no normal is too far


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"delta": -1.1}, "delta"),
        ({"delta": float("nan")}, "delta"),
        ({"cone": "wide"}, "cone"),
        ({"max_points": 0}, "max_points"),
    ],
)
def test_values_out_of_range_are_named(options: dict[str, Any], named: str) -> None:
    with pytest.raises(UsageError, match=named):
        SplitRule(**options)
