"""What a scan is of does not hang on its length, density, unit, place, turn, order or company.

Scenes of which the reading is known are scanned, and the points then changed in ways that leave
what there is to be seen: where the scan is taken to be seen from, whether that is sure, and which
sides face out stay. Turned over, only what habit decides may change.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple

import numpy as np
import pytest
from directions import random_directions
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.cloud.measure import measure_spacing
from hpcapp.applications.surface.normals.drive import orient_normals
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.frame import to_local
from hpcapp.lab.simulate.raw.scan import RawSettings, scan_scene
from hpcapp.lab.simulate.scanner import sample_surface
from hpcapp.lab.simulate.shapes import find_shape

ENOUGH = 0.9  # share of sure points below which a warning asks to look
FAR = 0.93, 0.7  # certainty so far from that of a sure side that a tenth less does not change it
REACH, CRATE = 8.0, np.array([1.6, 0.8, 0.7])  # of the scanner, and a crate's edges, in metres
APART = 0.05  # by how much the share of points on the right side may differ


class Scan(NamedTuple):
    """Points, and directions from each towards the side that was seen."""

    positions: FloatArray
    outwards: FloatArray


class Told(NamedTuple):
    """Where a scan is taken to be seen from, how sure that is, and how much of it is right."""

    how: str
    is_sure: bool
    right: float
    certainty: float


def read_scan(scan: Scan) -> Told:
    local, origin = to_local(scan.positions)
    cloud_pass = MemoryPass(arrange_cloud(PointCloud(local, origin=origin)))
    spacing = measure_spacing(cloud_pass)
    cloud_pass, told, verdict = orient_normals(cloud_pass, spacing, Sensor(), keeps=False)
    points = cloud_pass.cloud.points
    assert points.normals is not None
    rows = cKDTree(local).query(points.positions)[1]
    along = np.einsum("ij,ij->i", points.normals, scan.outwards[rows])
    # Inside and amid differ by how much of the sky is open: either is among the points.
    how = told.how.replace("amid the points", "inside")
    assert verdict is not None
    return Told(how, told.sure >= ENOUGH, float((along > 0.0).mean()), verdict.certainty)


def check_same(before: Told, after: Told) -> None:
    """Nothing is sure that was otherwise before, and what was far from unsure stays so."""
    high, low = FAR
    if before.certainty > high or before.certainty < low:
        assert after.is_sure == before.is_sure
    if after.is_sure:
        assert after.how == before.how
        assert after.right == pytest.approx(before.right, abs=APART)


def scan_truly(scene: str, scanner: str, points: int) -> Scan:
    raw = scan_scene(scene, scanner, RawSettings(points=points, seed=1))
    corners = raw.truth.vertices[raw.truth.faces]
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middles = corners.mean(axis=1) + raw.truth.origin
    rows = cKDTree(middles).query(raw.cloud.positions)[1]
    return Scan(raw.cloud.positions, faces[rows])


def sample_shape(name: str, points: int) -> Scan:
    cloud = sample_surface(find_shape(name), points)
    assert cloud.normals is not None
    return Scan(cloud.positions, cloud.normals.astype(np.float64))


def scan_corridor(length: float) -> Scan:
    """A corridor 3 wide and 2.6 high, with a crate that hangs in it and a stand every 3 metres."""
    random, count = np.random.default_rng(0), 3_000
    every = np.arange(1.5, length, 3.0)
    low = np.stack([every, np.full(len(every), 1.1), np.full(len(every), 0.7)], axis=1)
    parts = []
    for along in every:
        stand = np.array([along - 0.9, 0.75, 1.7])
        rays = random_directions(count, random)
        # (n, 3): how far the planes of the walls are along each ray.
        walls = np.where(rays > 0.0, np.array([length, 3.0, 2.6]) - stand, -stand) / rays
        # (c, n, 3): and where it enters and leaves the planes of the crates near by.
        near = low[np.abs(low[:, 0] - along) < REACH, None]
        planes = np.sort([(near - stand) / rays, (near + CRATE - stand) / rays], axis=0)
        enters, leaves = planes[0].max(axis=2), planes[1].min(axis=2)
        enters = np.where((enters < leaves) & (enters > 0.0), enters, np.inf)
        crate, rows = enters.argmin(axis=0), np.arange(count)
        is_crate = enters[crate, rows] < walls.min(axis=1)
        axis = np.where(is_crate, planes[0][crate, rows].argmax(axis=1), walls.argmin(axis=1))
        far = np.minimum(enters[crate, rows], walls.min(axis=1))
        hits = stand + rays * (far + random.normal(0.0, 0.002, count))[:, None]
        is_seen = far < REACH
        parts.append(Scan(hits[is_seen], (-np.sign(rays) * np.eye(3)[axis])[is_seen]))
    return Scan(*map(np.concatenate, zip(*parts, strict=True)))


SCENES: dict[str, Callable[[], Scan]] = {
    "object": partial(sample_shape, "torus", 5_000),
    "part": partial(sample_shape, "bracket", 8_000),
    "terrain": partial(scan_truly, "terrain", "airborne", 4_000),
    "heap": partial(scan_truly, "heap", "terrestrial", 6_000),
    "street": partial(scan_truly, "town", "terrestrial", 12_000),
    "room": partial(scan_truly, "room", "terrestrial", 24_000),
}


@cache
def find_scene(name: str) -> tuple[Scan, Told]:
    scan = SCENES[name]()
    return scan, read_scan(scan)


def keep_some(share: float, seed: int, scan: Scan) -> Scan:
    rows = np.flatnonzero(np.random.default_rng(seed).random(len(scan.positions)) < share)
    return Scan(scan.positions[rows], scan.outwards[rows])


def reorder(seed: int, scan: Scan) -> Scan:
    rows = np.random.default_rng(seed).permutation(len(scan.positions))
    return Scan(scan.positions[rows], scan.outwards[rows])


def scale(power: float, scan: Scan) -> Scan:
    return Scan(10.0**power * scan.positions, scan.outwards)


def turn(degrees: float, scan: Scan) -> Scan:
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    matrix = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return Scan(scan.positions @ matrix, scan.outwards @ matrix)


def move(extents: tuple[float, float, float], scan: Scan) -> Scan:
    size = float(np.ptp(scan.positions, axis=0).max())
    return Scan(scan.positions + size * np.array(extents), scan.outwards)


def copy_beside(gap: float, axis: int, scan: Scan) -> Scan:
    step = np.zeros(3)
    step[axis] = (1.0 + gap) * np.ptp(scan.positions, axis=0)[axis]
    both = np.concatenate([scan.positions, scan.positions + step])
    return Scan(both, np.concatenate([scan.outwards] * 2))


def turn_over(scan: Scan) -> Scan:
    return Scan(*(side * np.array([1.0, 1.0, -1.0]) for side in scan))


SEEDS = st.integers(0, 2**32 - 1)
# Sideways: what lies over or under zero, a camera at zero may have seen.
BESIDE = st.tuples(st.floats(5.0, 5_000.0), st.floats(5.0, 5_000.0), st.floats(-2.0, 2.0))
CHANGES = {
    "half of the points": SEEDS.map(lambda seed: partial(keep_some, 0.5, seed)),
    "a tenth left out": SEEDS.map(lambda seed: partial(keep_some, 0.9, seed)),
    "another order": SEEDS.map(lambda seed: partial(reorder, seed)),
    "another unit": st.floats(-4.0, 4.0).map(lambda power: partial(scale, power)),
    "turned about z": st.floats(0.0, 360.0).map(lambda degrees: partial(turn, degrees)),
    "moved": BESIDE.map(lambda extents: partial(move, extents)),
    "a copy beside it": st.sampled_from([(0.25, 0), (0.25, 1), (1.0, 0), (1.0, 1)]).map(
        lambda beside: partial(copy_beside, *beside)
    ),
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("scene", SCENES)
def test_a_reading_stays_where_what_is_seen_stays(scene: str, change: str) -> None:
    scan, before = find_scene(scene)

    @settings(max_examples=3, derandomize=True)
    @given(CHANGES[change])
    def check(apply: Callable[[Scan], Scan]) -> None:
        check_same(before, read_scan(apply(scan)))

    check()


@pytest.mark.parametrize("scene", SCENES)
def test_turned_over_only_habits_change(scene: str) -> None:
    scan, before = find_scene(scene)
    after = read_scan(turn_over(scan))
    if before.how == "from above":  # what lies level is taken for ground, whichever way it lies
        assert after.how in ("from above", "from below")
    else:
        check_same(before, after)


@pytest.mark.parametrize("length", [20.0, 60.0, 200.0])
def test_a_corridor_is_seen_from_inside_however_long_it_is(length: float) -> None:
    told = read_scan(scan_corridor(length))
    assert (told.how, told.is_sure) == ("from inside", True)
    assert told.right > 1.0 - 2.0 * APART  # within the crates, rays miss
