"""Heaps of known volumes above what the ground round them tells, on a map."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from contextlib import nullcontext
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapely

import hpcapp
from hpcapp.applications.compare.volume.base import fit_base
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import write_points
from hpcapp.terrain.heights import Heights
from hpcapp.terrain.lattice import Lattice

Run = Callable[..., tuple[int, str, str]]

PLACE = np.array([512_000.0, 5_403_000.0, 300.0])
MIDDLE, RADIUS, HIGH = np.array([20.0, 18.0]), 6.0, 4.0
CONE = np.pi * RADIUS**2 * HIGH / 3.0


@cache
def scan(noise: float = 0.03, slope: float = 0.1, seed: int = 0) -> PointCloud:
    """Return points of a cone on a slope, denser to the east."""
    rng = np.random.default_rng(seed)
    places = rng.random((30_000, 2)) ** (0.8, 1.0) * 40.0
    z = slope * places[:, 0] + np.maximum(HIGH * (1.0 - away(places) / RADIUS), 0.0)
    return PointCloud(np.column_stack([places, z + rng.normal(0.0, noise, len(z))]), origin=PLACE)


def away(places: FloatArray) -> FloatArray:
    distances: FloatArray = np.linalg.norm(places - MIDDLE, axis=1)
    return distances


def draw(radius: float, shift: tuple[float, float] = (0.0, 0.0)) -> shapely.Polygon:
    """Return a polygon round the cone, on the map."""
    return shapely.Point(*(MIDDLE + PLACE[:2] + shift)).buffer(radius)


def measure(cloud: PointCloud, polygon: shapely.Polygon, **options: object) -> hpcapp.Heap:
    (heap,) = hpcapp.measure_heaps(cloud, polygon.wkt, **options)  # type: ignore[arg-type]
    return heap


@pytest.fixture
def yard(tmp_path: Path) -> Path:
    write_points(tmp_path / "yard.laz", scan(), "EPSG:25832")
    shapes = {"cone": draw(6.5), "foot cut off": draw(5.4), "none": draw(3.0, (-14.0, 0.0))}
    features = [
        {"type": "Feature", "properties": {"name": name}, "geometry": shapely.geometry.mapping(one)}
        for name, one in shapes.items()
    ]
    toes = {"type": "FeatureCollection", "features": features}
    (tmp_path / "toes.geojson").write_text(json.dumps(toes))
    return tmp_path / "yard.laz"


@pytest.mark.parametrize("above", ["rim", "plane"])
def test_a_cone_on_a_slope_has_its_volume(above: str) -> None:
    heap = measure(scan(), draw(6.5), above=above)
    assert abs(heap.volume - CONE) <= heap.uncertainty
    assert heap.uncertainty < 0.04 * CONE
    assert heap.is_significant
    assert heap.height == pytest.approx(HIGH, abs=0.4)
    assert heap.area == pytest.approx(np.pi * 6.5**2, rel=0.01)


@pytest.mark.parametrize(("radius", "shift"), [(6.0, (1.0, 0.0)), (5.2, (0.0, 0.0))])
def test_a_polygon_a_metre_off_is_widened_to_the_toe(
    radius: float, shift: tuple[float, float]
) -> None:
    heap = measure(scan(), draw(radius, shift))
    assert heap.grown > 0.0
    assert heap.is_still
    assert abs(heap.volume - CONE) <= heap.uncertainty
    vouched = measure(scan(), draw(radius, shift), registration=0.0)
    assert vouched.volume < 0.9 * CONE
    told = measure(scan(), draw(radius, shift), registration=0.6)
    assert (vouched.grown, told.grown) == (0.0, 0.0)
    assert abs(told.volume - CONE) <= told.uncertainty


def test_a_height_counts_over_the_polygon_as_it_is_drawn() -> None:
    heap = measure(scan(slope=0.0), draw(3.0), above=301.0)
    # the frustum above 1 of a cone that is 4 high
    low, high = HIGH * (1.0 - 3.0 / RADIUS) - 1.0, HIGH - 1.0
    assert abs(heap.volume - np.pi * 9.0 * (low + (high - low) / 3.0)) <= heap.uncertainty
    assert heap.uncertainty < 0.02 * heap.volume
    assert heap.from_polygon == 0.0
    assert measure(scan(slope=0.0), draw(3.0), above=306.0).volume < 0.0


def test_a_hidden_side_is_filled_and_uncertain() -> None:
    whole = scan()
    shown = np.linalg.norm(whole.positions[:, :2] - MIDDLE - (2.5, 0.0), axis=1) > 1.2
    heap = measure(whole.take(shown), draw(6.5))
    assert heap.hidden == pytest.approx(np.pi * 1.2**2, rel=0.35)
    assert heap.from_hidden > 0.0
    assert abs(heap.volume - CONE) <= heap.uncertainty


def test_what_a_hidden_tip_adds_is_bounded_by_its_slope() -> None:
    whole = scan(0.003)
    heap = measure(whole.take(away(whole.positions[:, :2]) > 1.5), draw(6.5))
    tip = np.pi * 1.5**3 * (HIGH / RADIUS) / 3.0
    assert 1.05 * tip < heap.from_hidden < 2.5 * tip
    assert abs(heap.volume - CONE) <= heap.uncertainty


def test_a_part_of_a_polygon_beyond_the_scan_is_as_uncertain_as_the_heap_is_high() -> None:
    x, y = (PLACE[:2] + np.array([44.0, 18.0])).tolist()
    beyond = shapely.box(x, y, x + 2.0, y + 2.0)
    whole, part = (
        measure(scan(slope=0.0), one, above=300.0) for one in (draw(6.5), draw(6.5) | beyond)
    )
    assert part.hidden - whole.hidden == pytest.approx(4.0, rel=0.02)
    assert part.from_hidden - whole.from_hidden == pytest.approx(4.0 * 0.5 * HIGH, rel=0.1)
    assert abs(part.volume - whole.volume) < 4.0 * HIGH


def test_a_polygon_is_widened_by_a_quarter_at_most() -> None:
    reached, far = (measure(scan(), draw(radius)) for radius in (4.9, 4.4))
    assert reached.is_still
    assert reached.grown == pytest.approx(1.1, abs=0.3)
    assert (far.grown, far.is_still) == (0.0, False)
    assert abs(far.volume - CONE) <= far.uncertainty
    assert far.from_polygon > far.volume


@pytest.mark.parametrize(("shown", "is_told"), [(0.65, True), (0.35, False)])
def test_half_of_the_ground_round_a_heap_has_to_be_shown(shown: float, is_told: bool) -> None:
    x, y = (scan().positions[:, :2] - MIDDLE).T
    is_shown = (np.abs(np.arctan2(y, x)) < np.pi * shown) | (np.hypot(x, y) < 6.5)
    with nullcontext() if is_told else pytest.raises(hpcapp.InputError, match="the ground in"):
        measure(scan().take(is_shown), draw(6.5), registration=0.0)


def test_a_ring_may_add_unseen_what_a_volume_that_stays_may_change_by() -> None:
    heap = measure(scan(0.003, 0.0), draw(6.5))
    assert heap.from_polygon == pytest.approx(0.005 * heap.volume, rel=0.2)


@pytest.mark.parametrize(("side", "is_told"), [(3.0, True), (2.0, False)])  # 16 and 9 cells
def test_a_heap_of_less_than_a_dozen_cells_is_refused(side: float, is_told: bool) -> None:
    x, y = (PLACE[:2] + MIDDLE).tolist()
    with nullcontext() if is_told else pytest.raises(hpcapp.InputError, match="9 cells of it"):
        measure(scan(), shapely.box(x, y, x + side, y + side), above=300.0, cell=1.0)


def test_mean_errors_of_many_scans_are_within_what_noise_makes() -> None:
    off = [
        (measure(scan(0.2, seed=seed), draw(6.5), registration=0.0).volume - CONE)
        for seed in range(8)
    ]
    said = measure(scan(0.2), draw(6.5), registration=0.0).from_noise
    assert 0.3 < 1.96 * np.std(off) / said < 2.0


@pytest.mark.parametrize("is_membrane", [True, False])
@pytest.mark.parametrize(("bowl", "saddle"), [(0.0, 0.0), (0.0, 0.02), (0.02, 0.02)])
def test_what_the_ground_does_below_is_exact_or_uncertain(
    is_membrane: bool, bowl: float, saddle: float
) -> None:
    lattice = Lattice((0.0, 0.0), 0.25, (80, 80))
    x, y = np.moveaxis(lattice.middles - 10.0, -1, 0)
    ground = 1e3 + 0.2 * x - 0.1 * y + bowl * (x**2 + y**2) + saddle * (x**2 - y**2)
    r = np.hypot(x, 1.5 * y)
    areas = 0.0625 * (r < 8.0)
    is_near, is_known = r < 8.6, (r >= 8.0) & (r < 8.6)
    even, none = np.full(x.shape, 1e-4), np.zeros(x.shape, dtype=bool)
    heights = Heights(ground, even, ground, np.ones(x.shape), none)
    base = fit_base(is_membrane, areas, heights, is_near, is_known, lattice)
    off = abs(float((areas * (base.heights - ground)).sum()))
    if not bowl and (is_membrane or not saddle):
        assert off < 1e-3 * areas.sum() * max(saddle, 1e-6) * 64.0
    assert off <= base.uncertainty + 1e-6
    rim = np.count_nonzero(is_known)
    assert base.variance > 1e-4 * areas.sum() ** 2 / rim * 0.9


def test_a_mesh_tells_heaps_too(tmp_path: Path) -> None:
    y, x = np.indices((161, 161)) * 0.25
    places = np.stack([x.ravel(), y.ravel()], axis=1)
    z = 0.1 * places[:, 0] + np.maximum(HIGH * (1.0 - away(places) / RADIUS), 0.0)
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, d), (a, d, c))]
    mesh = hpcapp.Mesh(np.column_stack([places, z]), np.concatenate(faces))
    polygon = shapely.Point(*MIDDLE).buffer(6.5)
    (heap,) = hpcapp.measure_heaps(mesh, polygon.wkt)
    assert abs(heap.volume - CONE) <= heap.uncertainty < 0.05 * CONE


def test_many_polygons_give_a_table(run: Run, yard: Path, tmp_path: Path) -> None:
    words = ("compare", str(yard), "--volume", "--above", "rim", "--polygon", "toes.geojson")
    code, table, said = run(*words, "--csv", "heaps.csv")
    assert code == 0
    assert "heaps.csv: a table of 3 heaps" in said
    lines = table.splitlines()
    assert lines[0].split() == ["volume", "uncertainty", "most", "of", "it", "area", "height"]
    assert lines[1].startswith("cone ")
    assert lines[3].endswith("no heap is told")
    assert "foot cut off: its foot goes on beyond the polygon" in table
    with (tmp_path / "heaps.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["cone", "foot cut off", "none"]
    assert rows[0]["unit"] == "m"
    for row, truth in zip(rows, (CONE, CONE, 0.0), strict=True):
        assert abs(float(row["volume"]) - truth) <= float(row["uncertainty"])
    heaps = json.loads(run(*words, "--json")[1])["heaps"]
    assert [one["volume"] for one in heaps] == [float(row["volume"]) for row in rows]


def test_what_is_no_heap_is_refused_in_one_line(run: Run, yard: Path, tmp_path: Path) -> None:
    cut = scan().take(away(scan().positions[:, :2]) < 6.5)
    write_points(tmp_path / "cut.laz", cut, "EPSG:25832")
    toe, name = draw(6.5).wkt, str(yard)
    heap = ("--volume", "--above", "rim", "--polygon", toe)
    for code, words, problem in (
        (2, (name,), "nothing to compare with"),
        (2, (name, "--volume", "--above", "rim"), "needs --volume, --above and --polygon"),
        (2, (name, "--above", "rim", "--polygon", toe), "needs --volume, --above and --polygon"),
        (2, (name, name, *heap), "TRUTH stands beside --above"),
        (2, (name, *heap, "--png", "heap.png"), "--png stands beside --above"),
        (2, (name, "--volume", "--above", "rmi", "--polygon", toe), "--above rmi: it is no base"),
        (2, (name, "--volume", "--above", "nan", "--polygon", toe), "--above nan: it is no base"),
        (2, (name, *heap, "--cell", "0.001"), "give --cell"),
        (2, (name, *heap, "--csv", "heaps.txt"), "is no table"),
        (3, (name, *heap[:-1], "POLYGON ((0 0, 9 0, 9 9, 0 0))"), "no points in heap"),
        (3, ("cut.laz", *heap), "or give the height of the base as --above 12.5"),
        (3, (name, *heap[:-1], "no.geojson"), "no.geojson"),
    ):
        result = run("compare", *words)
        assert result[0] == code, result
        last = result[2].strip().splitlines()[-1]
        assert last.startswith("hpcapp: ")
        assert problem in last
    assert {one.name for one in tmp_path.iterdir()} == {"cut.laz", "toes.geojson", "yard.laz"}
