"""Whatever is handed over, a kernel refuses it in words or gives a result: it never crashes."""

from __future__ import annotations

import contextlib
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hpcapp.geometry.lattice import pack_places
from hpcapp.kernels import portable
from hpcapp.kernels.case_table import case_triangles
from hpcapp.kernels.types.field import FarField, Features, Field, FieldLevel
from hpcapp.kernels.types.grid import BrickKinds, BrickStrides, Grid

KERNELS = sorted({*portable.KERNELS} - {"bound_free_memory", "keep_memory"})

numbers = st.one_of(
    st.integers(-3, 70), st.sampled_from([2**31, 2**62, -(2**63), 0.0, -1.0, 1e-300, 1e300]),
    st.just(float("nan")), st.just(float("inf")), st.floats(0.001, 2.0),
)  # fmt: skip
shapes = st.sampled_from(
    [(0,), (1,), (3,), (5,), (0, 3), (1, 3), (5, 3), (4, 44), (5, 10), (2, 2, 2), (1, 9, 9, 9)]
)
dtypes = st.sampled_from([np.float64, np.int64, np.float32, np.int8, np.bool_, np.complex64])


@st.composite
def hostile_arrays(draw: st.DrawFn) -> object:
    shape, dtype = draw(shapes), draw(dtypes)
    random = np.random.default_rng(draw(st.integers(0, 2**16)))
    values: NDArray[np.generic] = random.integers(-2, 5, size=shape).astype(dtype)
    if dtype == np.int64 and draw(st.booleans()):
        values = np.sort(random.integers(0, 2**62, size=shape), axis=0)
    if values.size and dtype == np.float64 and draw(st.booleans()):
        values.flat[0] = draw(st.sampled_from([np.nan, np.inf, 1e308, -1e308]))
    if draw(st.integers(0, 5)) == 0:
        values = values[..., ::-1]
    return values


sides = st.tuples(*[st.integers(-1, 9)] * 3)
anything = st.one_of(numbers, hostile_arrays(), st.just(case_triangles()), st.none(), st.text())
arguments = st.one_of(anything, st.tuples(anything, anything))
origins = st.one_of(anything, st.just(np.zeros(3)))
keys = st.one_of(anything, st.just(np.array([1, 5])))
levels = st.builds(FieldLevel, keys, anything, anything)
features = st.builds(Features, keys, anything, anything)
cubes = st.one_of(anything, st.just(np.ones((4, 4, 4), np.float32)))
fields = st.builds(
    Field, origins, numbers, st.lists(levels, max_size=2).map(tuple),
    st.one_of(anything, st.builds(FarField, cubes, origins, numbers)),
    st.one_of(anything, st.lists(st.one_of(anything, features), max_size=3).map(tuple)),
)  # fmt: skip
exponents = st.one_of(anything, st.just(np.array([0, 3], np.uint8)))
strides = st.one_of(st.none(), anything, st.builds(BrickStrides, keys, exponents))
grids = st.builds(Grid, origins, numbers, st.one_of(anything, sides), strides)
brick_kinds = st.builds(BrickKinds, origins, hostile_arrays())


@given(st.sampled_from(KERNELS), st.lists(arguments, min_size=1, max_size=8))
@settings(deadline=None, max_examples=400)
def test_random_arguments(native: ModuleType, name: str, values: list[object]) -> None:
    with contextlib.suppress(TypeError, ValueError, OverflowError, RuntimeError, MemoryError):
        getattr(native, name)(*values)


@given(*[st.one_of(anything, records) for records in (fields, grids, brick_kinds)])
@settings(deadline=None, max_examples=400)
def test_random_records(native: ModuleType, field: Any, grid: Any, kinds: Any) -> None:
    with contextlib.suppress(TypeError, ValueError):
        native.evaluate_bricks(field, grid, np.zeros((1, 3), np.int64))
    with contextlib.suppress(TypeError, ValueError):
        native.grow_surface(field, grid, kinds)
    with contextlib.suppress(TypeError, ValueError):
        native.seed_bricks(grid, np.ones((2, 3)))


@given(st.data())
@settings(deadline=None, max_examples=200)
def test_plausible_arguments(native: ModuleType, data: st.DataObject) -> None:
    """Arrays of the right kinds whose contents contradict one another."""
    draw = data.draw
    random = np.random.default_rng(draw(st.integers(0, 2**16)))
    rows = draw(st.integers(0, 20))
    points = random.normal(size=(rows, 3)) * draw(st.sampled_from([1.0, 1e9, 1e300]))
    keys = np.unique(random.integers(0, 2**63 - 1, size=rows))
    means = np.ones((len(keys), 10), np.float32)
    records = np.ones((rows, 6), np.float32)
    calls = [
        ("accumulate_moments", points, points, random.integers(-9, 30, size=5)),
        ("accumulate_moments", points, points, np.array([0, rows]), points[:, 0].copy()),
        ("rate_points", points, np.arange(len(keys) + 1), keys, 1, keys, means, means[:, 0]),
        ("sort_points", points, points[0] if rows else np.zeros(3), 0.1),
        ("pack_records", points, points, points[0] if rows else np.zeros(3), 0.1),
        ("bound_records", records * 0.5),
        ("fold_records", records * np.float32(0.3), *random.integers(-1, 34, size=(2, 7))),
        (
            "unfold_records",
            random.integers(0, 256, size=(rows, draw(st.integers(0, 28)))).astype(np.uint8),
            random.integers(-(2**62), 2**62, size=7) >> draw(st.integers(0, 62)),
            random.integers(-1, 34, size=7) // draw(st.integers(1, 9)),
            *random.integers(-1, rows + 1, size=(2, 2)),
            records,
        ),
        ("unpack_records", records, random.integers(-1, rows + 1, size=2), points[:2].copy(), 0.1),
        ("unpack_within", records, np.array([rows]), np.zeros((1, 3)), 0.1, *np.ones((2, 3))),
        ("mark_ancestors", keys, 3, keys),
        ("mark_near", keys, keys, *random.integers(-1, draw(st.sampled_from([9, 130])), (2, 3))),
        (
            "sort_packed",
            records,
            np.array([rows]),
            np.ones((1, 3)),
            0.1,
            np.ones(3),
            0.1,
            draw(st.integers(-1, 22)),
            keys,
            np.ones(len(keys), np.uint8),
        ),
        (
            "count_packed",
            records,
            random.integers(-1, rows + 1, size=2),
            points[:2].copy(),
            0.1,
            np.ones(3),
            0.1,
        ),
        (
            "place_packed",
            records,
            random.integers(0, 3, size=rows).astype(np.uint32),
            points[:2].copy(),
            0.1,
            np.ones(3),
            0.1,
        ),
        (
            "seed_packed",
            records,
            np.zeros(rows, np.uint32),
            points[:1].copy(),
            0.1,
            random.integers(-1, rows + 1, size=2),
            draw(st.sampled_from([np.ones(1, np.bool_), np.array(True)])),
            Grid(np.ones(3), 0.01, draw(sides)),
        ),
        ("look_near", keys, np.ones(3), 0.1, means.astype(np.uint8)[None], np.ones(3), 1.0, 0.5),
        (
            "mark_rim",
            means[None] > 0.0,
            draw(st.sampled_from([None, means.astype(np.uint8)[None]])),
        ),
        (
            "gather_points",
            points,
            points,
            random.integers(0, 30, size=9).astype(np.uint32),
            np.zeros(3),
            0.1,
        ),
        ("integrate_normals", points, points, 1.0, random.integers(-1, 9, size=(2, 2)), 8, 2),
        ("sample_corners", np.ones((4, 4, 4), np.float32), keys, points[:1].sum(axis=0), 1e300),
        ("corner_moments", keys, keys, random.normal(size=(len(keys), 44)), 2),
        ("inherit_level", keys, keys, means, means[:, :3].copy(), 2),
        (
            "fit_features",
            keys,
            keys,
            np.linspace(0, rows, len(keys) + 1).astype(np.int64),
            points,
            points,
            draw(st.sampled_from([0.0, 0.01, 1e300])),
            2,
        ),
        ("merge_cells", keys, np.ones((len(keys), 44))),
        ("sample_grid", np.ones((4, 4, 4), np.float32), points),
        ("seed_bricks", Grid(np.zeros(3), 0.06, draw(sides)), points),
        ("survey_mesh", random.integers(-1, 9, size=(rows, 3)), draw(st.integers(-2, 9))),
        ("balance_vertices", points, random.integers(-1, 9, size=(rows, 3)), 0.5),
        ("label_components", random.integers(0, 9, size=(rows, 3)), 9),
    ]
    name, *values = draw(st.sampled_from(calls))
    with contextlib.suppress(ValueError):
        getattr(native, name)(*values)


def test_coarse_cells_beyond_the_lattice(native: ModuleType) -> None:
    """They hold no point; a key of their finest cells would have more than 64 bits."""
    wanted = np.sort(pack_places(np.array([[-(2**20)] * 3, [0] * 3, [2**20 - 1] * 3])))
    packed = np.full((5, 6), 0.5, np.float32), np.array([5]), np.zeros((1, 3)), 1.0
    lattice = np.zeros(3), 0.25, 20, wanted, np.arange(3, dtype=np.uint8)
    cells, offsets, records, _, groups = native.sort_packed(*packed, *lattice)
    assert cells.tolist() == pack_places(np.array([[2, 2, 2]])).tolist()
    assert offsets.tolist() == [0, 5]
    assert len(records) == 5
    assert groups.tolist() == [1]


def test_messages_name_the_argument(native: ModuleType) -> None:
    points = np.zeros((4, 3))
    with pytest.raises(ValueError, match=r"offsets: .* number of points"):
        native.accumulate_moments(points, points, np.array([0, 9]))
    with pytest.raises(ValueError, match=r"normals: .* shape"):
        native.accumulate_moments(points, points[:2], np.array([0, 4]))
    with pytest.raises(ValueError, match=r"positions: .* dtype"):
        native.pack_records(points.astype(np.float32), points, points[0], 1.0)
    with pytest.raises(ValueError, match="C-contiguous"):
        native.pack_records(points[:, ::-1], points, points[0], 1.0)
    with pytest.raises(ValueError, match=r"keys: .* sorted"):
        native.spread_keys(np.array([3, 2]), 0, 1)
    with pytest.raises(ValueError, match="threads"):
        native.accumulate_moments(points, points, np.array([0, 4]), threads=0)
    with pytest.raises(ValueError, match="not finite"):
        native.sort_points(points * np.nan, np.zeros(3), 1.0)
