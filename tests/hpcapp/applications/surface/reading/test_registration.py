"""Scans that were not brought into one frame are told; others pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hpcapp.applications.surface.reading.registration import (
    AGREEING,
    check_registration,
    compare_scans,
)
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.points.point_source import Scan
from hpccomponent.errors import InputError

STANDS = (np.array([-5.0, -4.0, 3.0]), np.array([-4.0, 5.0, 2.0]))


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(0)


def box(random: np.random.Generator, stand: FloatArray, count: int = 60_000) -> PointCloud:
    """Scan a box with edges 2, 3 and 4 and some noise from a place outside."""
    half = np.array([1.0, 1.5, 2.0])
    areas = np.repeat(half.prod() / half, 2)
    face = random.choice(6, count, p=areas / areas.sum())
    axis, sign = face // 2, 2.0 * (face % 2) - 1.0
    places = random.uniform(-half, half, (count, 3))
    rows = np.arange(count)
    places[rows, axis] = sign * half[axis]
    seen = sign * (stand[axis] - places[rows, axis]) > 0.0
    return PointCloud(places[seen] + random.normal(0.0, 0.003, (int(seen.sum()), 3)), None)


def moved(cloud: PointCloud, degrees: float, shift: float) -> PointCloud:
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array([0.3, 0.4, 0.866])).as_matrix()
    return replace(cloud, positions=cloud.positions @ turn.T + shift)


def joined(clouds: Sequence[PointCloud]) -> list[PointCloud]:
    """Return the clouds in chunks, as a file of scans has them."""
    return [
        replace(cloud, attributes={"scan": np.full(len(cloud), number, np.int32)})
        for number, cloud in enumerate(clouds)
    ]


def placed(*stands: FloatArray) -> list[Scan]:
    return [Scan(scanner=stand) for stand in stands]


def two(random: np.random.Generator, degrees: float, shift: float) -> list[PointCloud]:
    first, second = (box(random, stand) for stand in STANDS)
    return joined([first, moved(second, degrees, shift)])


def test_registered_scans_pass(random: np.random.Generator) -> None:
    assert check_registration(two(random, 0.0, 0.0), placed(*STANDS)) is None
    assert check_registration(two(random, 0.2, 0.002), []) is None  # as a registration leaves them


@pytest.mark.parametrize(
    ("degrees", "shift"),
    [(0.0, 0.1), (0.0, 0.2), (0.0, 0.3), (12.0, 0.0), (70.0, 0.1)],
)
def test_scans_in_two_frames_are_told(
    random: np.random.Generator, degrees: float, shift: float
) -> None:
    warning = check_registration(two(random, degrees, shift), [])
    assert warning is not None
    assert "scans 1 and 2 do not fit together" in warning


SPACING = 0.03  # of the sparser scan


def share(clouds: Sequence[PointCloud]) -> float:
    samples = {i: (one.positions, np.zeros_like(one.positions)) for i, one in enumerate(clouds)}
    [pair] = compare_scans(samples)
    return pair.agreeing / pair.cells


@pytest.mark.parametrize("spacings", [3.0, 5.0, 10.0, 15.0])
def test_the_share_that_decides_has_a_margin(random: np.random.Generator, spacings: float) -> None:
    """A tenth more or less changes nothing; half as much more would refuse registered scans."""
    first, second = (box(random, stand) for stand in STANDS)
    registered = share([first, moved(second, 0.2, 0.002)])
    assert 1.1 * AGREEING < registered < 1.5 * AGREEING
    assert share([first, moved(second, 0.0, spacings * SPACING / np.sqrt(3.0))]) < 0.9 * AGREEING


def test_they_are_refused_where_the_sides_are_known(random: np.random.Generator) -> None:
    with pytest.raises(InputError, match="scans 1 and 2 do not fit together"):
        check_registration(two(random, 12.0, 0.0), placed(*STANDS))


def test_the_scan_that_does_not_fit_is_named(random: np.random.Generator) -> None:
    clouds = [box(random, STANDS[0]) for _ in range(3)]
    warning = check_registration(joined([*clouds, moved(clouds[0], 0.0, 0.1)]), [])
    assert warning is not None
    assert " and 4 do not fit together" in warning


def test_two_sides_of_a_thin_wall_fit(random: np.random.Generator) -> None:
    stands = np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, -2.0])
    flat = random.uniform(-1.0, 1.0, (2, 20_000, 3)) * (1.0, 1.0, 0.0)
    walls = joined([PointCloud(flat[0] + (0, 0, 0.02), None), PointCloud(flat[1], None)])
    assert check_registration(walls, placed(*stands)) is None
    warning = check_registration(walls, [])  # nothing tells that these are two sides
    assert warning is not None
    assert "thin walls" in warning


def test_scans_that_do_not_meet_pass(random: np.random.Generator) -> None:
    near = box(random, STANDS[0])
    assert check_registration(joined([near, moved(near, 0.0, 100.0)]), placed(*STANDS)) is None


def test_numbers_of_scan_lines_are_no_scans(random: np.random.Generator) -> None:
    cloud = box(random, STANDS[0])
    lines = np.arange(len(cloud)) // 80
    assert check_registration([replace(cloud, attributes={"scan": lines})], []) is None


def test_the_chunks_do_not_matter(random: np.random.Generator) -> None:
    first, second = two(random, 12.0, 0.0)
    cut = [first.view(slice(0, 777)), first.view(slice(777, None)), second]
    assert check_registration(cut, []) == check_registration([first, second], [])
