"""What a scan is of is told by what its viewers see from behind, and by what none of them sees."""

from __future__ import annotations

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.normals.estimation import estimate_normals
from hpcapp.applications.surface.normals.evidence import visibility
from hpcapp.applications.surface.normals.evidence.inside import (
    AMID,
    AMPLE,
    INSIDE,
    TIGHT,
    find_inside,
)
from hpcapp.applications.surface.normals.evidence.likelihood import FITTED, ReadingFeatures
from hpcapp.applications.surface.normals.evidence.linked import LinkedPatches
from hpcapp.applications.surface.normals.evidence.readings import Followed, weigh_readings
from hpcapp.applications.surface.normals.evidence.stand import Density
from hpcapp.applications.surface.normals.orientation import SURE, Orientation, orient_patches
from hpcapp.applications.surface.normals.patches import Links, Patches, find_patches, turn_points
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.geometry.points import Float32Array, FloatArray
from hpccomponent.errors import InputError

FAR = np.full(3, 1e9)
TOLD_INSIDE = Sensor("inside", is_told=True)


def _group(positions: FloatArray) -> tuple[Patches, Links, float, Float32Array]:
    every, low = np.ones(len(positions), np.bool_), positions.min(axis=0)
    spacing = estimate_spacing(positions)
    vectors = estimate_normals(positions, every, low, spacing)
    return *find_patches(positions, vectors, every, low, spacing), spacing, vectors


def _read(positions: FloatArray, zero: FloatArray = FAR) -> list[Followed]:
    patches, links, spacing, _ = _group(positions)
    return weigh_readings(patches, LinkedPatches(patches, links), spacing, zero, Sensor())


def _orient(
    positions: FloatArray, sensor: Sensor | None = None, zero: FloatArray = FAR
) -> tuple[FloatArray, Orientation]:
    patches, links, spacing, vectors = _group(positions)
    oriented = orient_patches(patches, links, spacing, zero, sensor or Sensor())
    low = positions.min(axis=0)
    normals = turn_points(positions, vectors, low, spacing, oriented.sides)[0]
    return normals.astype(np.float64), oriented


def _share_sure(oriented: Orientation) -> float:
    return float((np.abs(oriented.sides.values) >= SURE).mean())


def _tunnel() -> tuple[FloatArray, FloatArray]:
    """A bent tube with open ends, and where its axis is nearest to each point."""
    random = np.random.default_rng(0)
    bend, turn = random.uniform(0.0, np.pi, 14_000), random.uniform(0.0, 2.0 * np.pi, 14_000)
    outwards = np.stack([np.cos(bend), np.sin(bend), np.zeros(len(bend))], axis=1)
    wall = np.cos(turn)[:, None] * outwards
    wall[:, 2] = np.sin(turn)
    axis = 6.0 * outwards
    return axis + wall, axis


def _slope(degrees: float) -> FloatArray:
    random = np.random.default_rng(1)
    slope = random.uniform(-1.0, 1.0, (6_000, 3))
    slope[:, 2] = 0.05 * np.sin(5.0 * slope[:, 0]) * np.cos(4.0 * slope[:, 1])
    lean = np.radians(degrees)
    turned = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(lean), -np.sin(lean)],
                       [0.0, np.sin(lean), np.cos(lean)]])  # fmt: skip
    slope @= turned.T
    return slope


def _stairs() -> FloatArray:
    """Twelve steps, treads and risers."""
    random = np.random.default_rng(2)
    along, across = random.uniform(0.0, 12.0, 9_000), random.uniform(0.0, 6.0, 9_000)
    step, share = np.floor(along), along % 1.0
    is_tread = share < 0.6
    y = step + np.where(is_tread, share / 0.6, 1.0)
    z = 0.6 * (step + np.where(is_tread, 0.0, (share - 0.6) / 0.4))
    return np.stack([across, y, z], axis=1)


def _houses() -> FloatArray:
    """Ground with four flat roofs, and their walls."""
    random = np.random.default_rng(3)
    ground = random.uniform(-20.0, 20.0, (9_000, 3))
    near = np.abs(np.abs(ground[:, :2]) - 10.0).max(axis=1)
    ground[:, 2] = np.where(near < 3.0, 5.0, 0.3 * np.sin(0.3 * ground[:, 0]))
    walls = random.uniform(-3.0, 3.0, (3_000, 3))
    rows, sides = np.arange(len(walls)), random.integers(0, 2, len(walls))
    walls[rows, sides] = np.where(random.random(len(walls)) < 0.5, -3.0, 3.0)
    walls[:, 2] = random.uniform(0.0, 5.0, len(walls))
    walls[:, :2] += random.choice([-10.0, 10.0], (len(walls), 2))
    return np.concatenate([ground, walls])


def _turn_around(count: int) -> FloatArray:
    """Rays of a scanner that turns, as many in every direction."""
    return random_directions(count, 5)


def _street(stands: FloatArray, sides: tuple[float, ...], height: float) -> FloatArray:
    """Ground and fronts, 16 apart, from where a scanner stood that sees 25 far."""
    parts = []
    for stand in stands:
        rays = _turn_around(8_000)
        front = (np.sign(rays[:, 0]) * 8.0 - stand[0]) / rays[:, 0]
        rises = (stand + rays * front[:, None])[:, 2] < height
        far = np.where(rises & np.isin(np.sign(rays[:, 0]), sides), front, np.inf)
        far = np.minimum(far, np.where(rays[:, 2] < 0.0, -stand[2] / rays[:, 2], np.inf))
        is_seen = far < 25.0
        parts.append((stand + rays * far[:, None])[is_seen])
    street = np.concatenate(parts)
    return street + np.random.default_rng(6).normal(scale=0.002, size=street.shape)


def _ceiling(narrowest: float) -> FloatArray:
    """What a scanner at zero sees of a wavy sheet over it, within some cosine of up."""
    rays = _turn_around(int(12_000 / (1.0 - narrowest)))
    rays = rays[rays[:, 2] > narrowest] * 0.75 / rays[rays[:, 2] > narrowest, 2:]
    waves = np.sin(5.0 * rays[:, :1]) * np.cos(4.0 * rays[:, 1:2])
    return rays * (1.0 + 0.04 * waves)


def test_a_bent_tunnel_is_seen_from_inside_along_its_whole_length() -> None:
    wall, axis = _tunnel()
    patches, _, spacing, _ = _group(wall)
    (inside,) = find_inside(patches, spacing, AMPLE)
    places = inside.every
    middle = np.arctan2(places[:, 1], places[:, 0])
    assert np.ptp(middle) > 0.8 * np.pi
    assert np.abs(np.hypot(places[:, 0], places[:, 1]) - 6.0).max() < 0.7
    for sensor in (None, TOLD_INSIDE):
        normals, oriented = _orient(wall, sensor)
        assert (np.einsum("ij,ij->i", normals, axis - wall) > 0.0).mean() > 0.99
        assert oriented.how in ("from inside", "from amid the points")


def test_what_is_told_to_be_seen_from_outside_is() -> None:
    wall, axis = _tunnel()
    normals, oriented = _orient(wall, Sensor("outside", is_told=True))
    assert (np.einsum("ij,ij->i", normals, axis - wall) < 0.0).mean() > 0.99
    assert _share_sure(oriented) > 0.99


@pytest.mark.parametrize(("degrees", "is_sure"), [(0.0, True), (20.0, True), (35.0, True)])
def test_a_slope_is_ground_and_faces_up(degrees: float, is_sure: bool) -> None:
    normals, oriented = _orient(_slope(degrees))
    assert (normals[:, 2] > 0.0).mean() > 0.99
    assert _share_sure(oriented) == float(is_sure)


@pytest.mark.parametrize("distance", [0.75, 0.4, -2.0])
def test_what_lies_evenly_over_its_zero_is_no_scan_from_there(distance: float) -> None:
    normals, oriented = _orient(_slope(0.0), zero=np.array([0.0, 0.0, -distance]))
    assert (normals[:, 2] > 0.0).mean() > 0.99
    assert _share_sure(oriented) == 1.0


def test_rays_from_zero_tell_as_far_as_they_spread() -> None:
    """Over a few degrees they are as even as ground from above, over many as nothing else is."""
    ceilings = [_ceiling(narrowest) for narrowest in (0.5, 0.8, 0.95)]
    read = [{one.hypothesis.name: one.share for one in _read(c, np.zeros(3))} for c in ceilings]
    shares = [found.get("sensor", 0.0) for found in read]
    assert np.diff(shares).max() < 0.0
    wide, _, narrow = (_orient(ceiling, zero=np.zeros(3)) for ceiling in ceilings)
    assert (wide[0][:, 2] < 0.0).mean() > 0.99
    assert _share_sure(wide[1]) == 1.0
    assert (narrow[0][:, 2] > 0.0).mean() > 0.99


@pytest.mark.parametrize("degrees", [60.0, 90.0])
def test_an_open_sheet_that_stands_is_unsure(degrees: float) -> None:
    _, oriented = _orient(_slope(degrees))
    assert _share_sure(oriented) < 0.1
    assert oriented.doubt is not None
    assert oriented.doubt.rival is not None


@pytest.mark.parametrize(("sides", "height"), [((-1.0, 1.0), 4.0), ((1.0,), 8.0)])
def test_a_street_is_seen_from_amid_though_the_sky_is_open(
    sides: tuple[float, ...], height: float
) -> None:
    street = _street(np.array([[0.0, -10.0, 1.7], [1.0, 10.0, 1.7]]), sides, height)
    patches, _, spacing, _ = _group(street)
    rooms, *_, amid = find_inside(patches, spacing, TIGHT, shares=(INSIDE, *AMID))
    assert not len(rooms)
    assert len(amid)
    is_ground = street[:, 2] < 0.05
    inwards = np.where(is_ground[:, None], [0.0, 0.0, 1.0], -np.sign(street) * [1.0, 0.0, 0.0])
    for sensor, how in ((None, "from amid the points"), (TOLD_INSIDE, "from inside")):
        normals, oriented = _orient(street, sensor)
        assert oriented.how == how
        assert (np.einsum("ij,ij->i", normals, inwards) > 0.0).mean() > 0.99
        assert _share_sure(oriented) > 0.9


def test_a_sensor_at_zero_amid_its_points_is_told() -> None:
    stand = np.array([0.0, 0.0, 1.7])
    sweep = _street(np.array([stand]), (-1.0, 1.0), 8.0) - stand
    normals, oriented = _orient(sweep, zero=np.zeros(3))
    assert oriented.how == "from a sensor at (0, 0, 0)"
    assert (np.einsum("ij,ij->i", normals, -sweep) > 0.0).mean() > 0.99
    assert _share_sure(oriented) > 0.95


def test_density_favours_the_place_that_a_scanner_turned_in() -> None:
    stand, elsewhere = np.array([[0.0, 0.0, 1.7]]), np.array([[5.0, 15.0, 1.7]])
    taken = _street(stand, (-1.0, 1.0), 4.0)
    patches, _, spacing, _ = _group(taken)
    density = Density.of(patches, spacing)
    assert density.favour(patches, stand) > 0.5
    assert density.favour(patches, elsewhere) < 0.0


@pytest.mark.parametrize("even", [_houses(), _stairs(), _tunnel()[0], _slope(0.0)])
def test_density_favours_no_place_where_points_lie_evenly(even: FloatArray) -> None:
    patches, _, spacing, _ = _group(even)
    density, middle = Density.of(patches, spacing), even.mean(axis=0)
    for height in (0.5, 1.0, 2.0):
        assert density.favour(patches, middle[None] + [0.0, 0.0, height]) <= 0.0


def test_odds_fall_with_the_cost() -> None:
    odds = [FITTED.odds(ReadingFeatures("side", cost)) for cost in (0.0, 0.001, 0.01, 0.1, 1.0)]
    assert np.diff(odds).max() < 0.0


@pytest.mark.parametrize("broken", [0.0, 0.02, 0.2])
def test_shares_lack_to_1_what_wrong_links_take(broken: float) -> None:
    features = [
        ReadingFeatures("outside", 0.01),
        ReadingFeatures("amid", 0.0),
        ReadingFeatures("side", 0.2),
    ]
    shares = FITTED.find_shares(features, broken)
    assert (shares > 0.0).all()
    assert shares.sum() < 1.0
    assert shares.sum() > FITTED.find_shares(features, broken + 0.05).sum()


def test_stairs_face_up_or_are_unsure() -> None:
    """They have two sides, of which y may be up."""
    normals, oriented = _orient(_stairs())
    assert (normals[:, 2] > -0.5).mean() > 0.99 or _share_sure(oriented) == 0.0


def test_houses_on_the_ground_tell_above_from_below() -> None:
    normals, oriented = _orient(_houses())
    assert (normals[:9_000, 2] > 0.0).mean() > 0.98
    assert oriented.how == "from above"
    assert _share_sure(oriented) > 0.95


def test_nothing_is_inside_of_a_sheet() -> None:
    with pytest.raises(InputError, match="no place inside was found"):
        _orient(_slope(0.0), TOLD_INSIDE)


def test_a_ball_is_no_room() -> None:
    ball = random_directions(9_000, 4)
    assert _read(ball)[0].hypothesis.name == "outside"
    normals, oriented = _orient(ball)
    assert (np.einsum("ij,ij->i", normals, ball) > 0.0).all()
    assert _share_sure(oriented) == 1.0


def test_a_cube_is_no_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planes across its edges are seen from behind by who sees one of the two faces."""
    places = np.stack(np.meshgrid(*[np.arange(31.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    cube = places[((places == 0.0) | (places == 30.0)).any(axis=1)]
    cube += 0.1 * np.random.default_rng(0).normal(size=cube.shape)  # or edges have two planes
    assert _read(cube)[0].hypothesis.name == "outside"
    cost = min(one.features.cost for one in _read(cube) if one.hypothesis.name == "outside")
    monkeypatch.setattr(visibility, "_BENT", 2.0 * visibility._BENT)
    costs = [one.features.cost for one in _read(cube) if one.hypothesis.name == "outside"]
    assert min(costs, default=1.0) > 2.0 * cost


def test_shares_of_all_readings_add_up_to_1_at_most() -> None:
    for positions in (_slope(50.0), _stairs(), _tunnel()[0]):
        total = sum(followed.share for followed in _read(positions))
        assert 0.9 < total <= 1.0
