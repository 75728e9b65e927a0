"""The kernels in C++: each checks and converts its arrays, and calls the extension.

Each function has its full description at the one of the same name in `portable`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.build import load_native
from hpccomponent.surface.kernels.case_table import case_triangles
from hpccomponent.surface.types.field import Field
from hpccomponent.surface.types.grid import BRICK, BrickKinds, Grid
from hpccomponent.surface.types.mesh import BrickMesh, BrickSums, Seams, Survey
from hpccomponent.surface.types.points import (
    BoolArray,
    ByteArray,
    Float32Array,
    FloatArray,
    Int32Array,
    IntArray,
)

__all__ = [
    "accumulate_moments", "balance_vertices", "bound_free_memory", "bound_points",
    "corner_moments", "count_boxes", "count_cells", "count_packed", "evaluate_bricks",
    "evaluate_residuals", "find_keys", "find_seams", "fit_corners", "fit_features", "gather_points",
    "grow_surface", "inherit_level", "integrate_normals", "keep_memory", "label_cells",
    "label_components", "look_near", "mark_ancestors", "mark_near", "merge_cells", "pack_records",
    "parent_keys", "place_packed", "poll_normals", "rate_points", "sample_boxes",
    "sample_corners", "sample_grid", "seed_bricks", "seed_packed", "signed_volume", "sort_packed",
    "sort_points", "spread_keys", "sum_bricks", "sum_neighbours", "survey_mesh", "take_cells",
    "unite_keys", "unpack_records", "unpack_within",
]  # fmt: skip

_native: Any = load_native()

Blocks = NDArray[np.uint32]


def _floats(values: Any) -> FloatArray:
    return np.ascontiguousarray(values, np.float64)


def _singles(values: Any) -> Float32Array:
    return np.ascontiguousarray(values, np.float32)


def _integers(values: Any) -> IntArray:
    return np.ascontiguousarray(values, np.int64)


def bound_points(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the box around some points."""
    bounds: tuple[FloatArray, FloatArray] = _native.bound_points(_floats(positions))
    return bounds


def count_boxes(
    positions: FloatArray, low: FloatArray, edge: float, one_in: int
) -> tuple[int, int]:
    """Count points and occupied boxes over a sample of the boxes."""
    counts: tuple[int, int] = _native.count_boxes(_floats(positions), _floats(low), edge, one_in)
    return counts


def sample_boxes(positions: FloatArray, low: FloatArray, edge: float, one_in: int) -> IntArray:
    """Return the points in a sample of boxes."""
    rows: IntArray = _native.sample_boxes(_floats(positions), _floats(low), edge, one_in)
    return rows


def sort_points(
    positions: FloatArray, origin: FloatArray, cell_size: float
) -> tuple[IntArray, IntArray, NDArray[np.uint32]]:
    """Sort points by the cell that they lie in."""
    result: tuple[IntArray, IntArray, NDArray[np.uint32]] = _native.sort_points(
        _floats(positions), _floats(origin), cell_size
    )
    return result


def gather_points(
    positions: FloatArray,
    normals: FloatArray,
    rows: NDArray[np.uint32],
    origin: FloatArray,
    cell_size: float,
) -> tuple[FloatArray, FloatArray]:
    """Return some points relative to the centres of their cells."""
    points = (_floats(positions), _floats(normals))
    result: tuple[FloatArray, FloatArray] = _native.gather_points(
        *points, rows, _floats(origin), cell_size
    )
    return result


def count_cells(
    positions: FloatArray, low: FloatArray, edge: float
) -> tuple[IntArray, IntArray, IntArray]:
    """Count the points in each occupied cell."""
    result: tuple[IntArray, IntArray, IntArray] = _native.count_cells(
        _floats(positions), _floats(low), edge
    )
    return result


def sum_neighbours(keys: IntArray, values: IntArray, wanted: IntArray) -> IntArray:
    """Sum values over the 27 cells around some cells."""
    result: IntArray = _native.sum_neighbours(_integers(keys), _integers(values), _integers(wanted))
    return result


def poll_normals(
    positions: FloatArray,
    normals: FloatArray | Float32Array,
    keys: IntArray,
    cell_of: IntArray,
    asked: ByteArray,
    reach: float,
    tolerance: float,
    drift: float,
    threads: int = 1,
) -> ByteArray:
    """Ask the neighbours of each point about its normal."""
    narrow = normals.dtype == np.float32
    points = (_floats(positions), _singles(normals) if narrow else _floats(normals))
    cells = (_integers(keys), _integers(cell_of))
    lengths = (reach, tolerance, drift)
    result: ByteArray = _native.poll_normals(*points, *cells, asked, *lengths, threads)
    return result


def accumulate_moments(
    local_positions: FloatArray,
    normals: FloatArray,
    offsets: IntArray,
    weights: FloatArray | None = None,
    threads: int = 1,
) -> FloatArray:
    """Sum the moments of the points of each cell (a task)."""
    kernel = _native.accumulate_moments if weights is None else _native.accumulate_weighted
    weighed = () if weights is None else (_floats(weights),)
    points = _floats(local_positions), _floats(normals), *weighed, _integers(offsets)
    result: FloatArray = kernel(*points, threads)
    return result


def merge_cells(cells: IntArray, moments: FloatArray) -> tuple[IntArray, FloatArray]:
    """Sum the moments of each eight children."""
    result: tuple[IntArray, FloatArray] = _native.merge_cells(_integers(cells), _floats(moments))
    return result


def spread_keys(keys: IntArray, low: int, high: int) -> IntArray:
    """Return the places within a box around each place."""
    result: IntArray = _native.spread_keys(_integers(keys), low, high)
    return result


def parent_keys(vertices: IntArray) -> IntArray:
    """Return every parent of some corners."""
    result: IntArray = _native.parent_keys(_integers(vertices))
    return result


def unite_keys(first: IntArray, second: IntArray) -> IntArray:
    """Return the union of two sorted sets of keys."""
    result: IntArray = _native.unite_keys(_integers(first), _integers(second))
    return result


def find_keys(keys: IntArray, wanted: IntArray, threads: int = 1) -> IntArray:
    """Return where each of some keys (v,) stands among sorted keys."""
    result: IntArray = _native.find_keys(_integers(keys), _integers(wanted), threads)
    return result


def inherit_level(
    vertices: IntArray,
    parents: IntArray,
    coefficients: Float32Array,
    values: Float32Array,
    threads: int = 1,
) -> tuple[Float32Array, Float32Array]:
    """Return the means of the parents' quadrics and values."""
    keys = (_integers(vertices), _integers(parents))
    of_parents = (_singles(coefficients), _singles(values))
    result: tuple[Float32Array, Float32Array] = _native.inherit_level(*keys, *of_parents, threads)
    return result


def corner_moments(
    touched: IntArray, cells: IntArray, moments: FloatArray, threads: int = 1
) -> FloatArray:
    """Sum the moments of the eight cells around each corner."""
    result: FloatArray = _native.corner_moments(
        _integers(touched), _integers(cells), _floats(moments), threads
    )
    return result


def fit_corners(
    touched: IntArray,
    cells: IntArray,
    moments: FloatArray,
    prior: Float32Array,
    noise: Float32Array,
    lam: float,
    least_mu: float,
    most_mu: float,
    threads: int = 1,
) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array]:
    """Fit a quadric to the points around each corner (a task)."""
    weights = (lam, least_mu, most_mu)
    keys = (_integers(touched), _integers(cells))
    values = (_floats(moments), _singles(prior), _singles(noise))
    result: tuple[Float32Array, Float32Array, Float32Array, Float32Array] = _native.fit_corners(
        *keys, *values, *weights, threads
    )
    return result


def fit_features(
    vertices: IntArray,
    cells: IntArray,
    offsets: IntArray,
    local_positions: FloatArray,
    normals: FloatArray,
    noise: float,
    threads: int = 1,
) -> tuple[Float32Array, ByteArray]:
    """Fit joined quadrics around vertices (a task)."""
    keys = (_integers(vertices), _integers(cells), _integers(offsets))
    points = (_floats(local_positions), _floats(normals))
    result: tuple[Float32Array, ByteArray] = _native.fit_features(*keys, *points, noise, threads)
    return result


def evaluate_residuals(moments: FloatArray, coefficients: FloatArray | Float32Array) -> FloatArray:
    """Return the sum of f^2 at each vertex."""
    result: FloatArray = _native.evaluate_residuals(_floats(moments), _floats(coefficients))
    return result


def integrate_normals(
    places: FloatArray,
    normals: FloatArray,
    smoothing: float,
    held: IntArray,
    nodes: int,
    threads: int = 1,
) -> Float32Array:
    """Integrate normals that are spread on a grid."""
    samples = (_floats(places), _floats(normals))
    result: Float32Array = _native.integrate_normals(
        *samples, smoothing, _integers(held), nodes, threads
    )
    return result


def sample_grid(values: Float32Array, places: FloatArray) -> FloatArray:
    """Interpolate a grid trilinearly."""
    result: FloatArray = _native.sample_grid(values, _floats(places))
    return result


def sample_corners(
    values: Float32Array, keys: IntArray, origin: FloatArray, spacing: float
) -> FloatArray:
    """Interpolate a grid at the corners of a lattice."""
    result: FloatArray = _native.sample_corners(values, _integers(keys), _floats(origin), spacing)
    return result


def seed_bricks(grid: Grid, positions: FloatArray) -> IntArray:
    """Return the bricks that hold a point."""
    edge = BRICK * grid.step
    result: IntArray = _native.seed_bricks(
        _floats(positions), _floats(grid.origin), edge, _integers(grid.bricks)
    )
    return result


def evaluate_bricks(field: Field, grid: Grid, places: IntArray, threads: int = 1) -> Float32Array:
    """Evaluate the implicit function at the nodes of bricks."""
    result: Float32Array = _native.evaluate_bricks(
        _field_values(field), *_grid_values(grid), _integers(places), threads
    )
    return result


def grow_surface(field: Field, grid: Grid, kinds: BrickKinds, threads: int = 1) -> BrickMesh:
    """Extract the surface that a tile reaches."""
    box = (_integers(kinds.first), np.ascontiguousarray(kinds.kinds, np.uint8))
    values = *_grid_values(grid), *box, case_triangles(), threads
    return BrickMesh(*_native.grow_surface(_field_values(field), *values))


def balance_vertices(vertices: FloatArray, faces: IntArray, step: float) -> FloatArray:
    """Move vertices so that the faces balance around the surface."""
    result: FloatArray = _native.balance_vertices(_floats(vertices), _integers(faces), step)
    return result


def label_components(faces: IntArray, vertices: int) -> tuple[int, Int32Array]:
    """Find the pieces of a mesh."""
    result: tuple[int, Int32Array] = _native.label_components(_integers(faces), vertices)
    return result


def survey_mesh(faces: IntArray, vertices: int) -> Survey:
    """Count what is to know about the edges of a mesh."""
    return Survey(*_native.survey_mesh(_integers(faces), vertices))


def signed_volume(vertices: FloatArray, faces: IntArray, reference: FloatArray) -> float:
    """Return the volume inside a closed mesh."""
    return float(_native.signed_volume(_floats(vertices), _integers(faces), _floats(reference)))


def find_seams(
    faces: Int32Array, counts: tuple[int, int], vertex_of: Int32Array, is_open: BoolArray
) -> Seams:
    """Find the open vertices of a part."""
    return Seams(*_native.find_seams(faces, *counts, vertex_of, is_open))


def sum_bricks(
    vertices: FloatArray,
    faces: Int32Array,
    counts: tuple[Int32Array, Int32Array],
    labels: Int32Array,
    components: int,
) -> BrickSums:
    """Sum over what each brick holds."""
    starts, entries, bounds = _native.sum_bricks(
        _floats(vertices), faces, *counts, labels, components
    )
    kinds, of_vertices, of_faces, sums = entries
    return BrickSums(starts, kinds, of_vertices, of_faces, sums, bounds)


def label_cells(keys: IntArray) -> tuple[int, Int32Array]:
    """Number the pieces of cells that touch."""
    result: tuple[int, Int32Array] = _native.label_cells(_integers(keys))
    return result


def take_cells(
    positions: FloatArray,
    normals: FloatArray,
    origin: FloatArray,
    cell_size: float,
    wanted: IntArray,
    groups: ByteArray,
) -> tuple[FloatArray, FloatArray, ByteArray]:
    """Return the points in some cells."""
    result: tuple[FloatArray, FloatArray, ByteArray] = _native.take_cells(
        positions, normals, origin, cell_size, wanted, groups
    )
    return result


def mark_ancestors(cells: IntArray, depth: int, ancestors: IntArray) -> NDArray[np.uint32]:
    """Tell which cells of a level are ancestors of some of the finest."""
    result: NDArray[np.uint32] = _native.mark_ancestors(
        _integers(cells), depth, _integers(ancestors)
    )
    return result


def mark_near(keys: IntArray, cells: IntArray, low: IntArray, high: IntArray) -> BoolArray:
    """Tell which of some keys lie in boxes around some cells."""
    result: BoolArray = _native.mark_near(_integers(keys), _integers(cells), low, high)
    return result


def look_near(
    cells: IntArray,
    origin: FloatArray,
    cell_size: float,
    pairs: ByteArray,
    corner: FloatArray,
    edge: float,
    margin: float,
    beyond: int,
) -> BoolArray:
    """Look up the middles of cells among bricks."""
    result: BoolArray = _native.look_near(
        _integers(cells), origin, cell_size, pairs, corner, edge, margin, beyond
    )
    return result


def rate_points(
    local: FloatArray,
    offsets: IntArray,
    cells: IntArray,
    depth: int,
    corners: IntArray,
    coefficients: Float32Array,
    variances: Float32Array,
) -> FloatArray:
    """Return how far points lie from the blend of a level's quadrics."""
    result: FloatArray = _native.rate_points(
        local, offsets, cells, depth, corners, coefficients, variances, 1
    )
    return result


def pack_records(
    positions: FloatArray, normals: FloatArray, origin: FloatArray, edge: float
) -> tuple[IntArray, IntArray, Float32Array]:
    """Sort points by blocks and pack them."""
    result: tuple[IntArray, IntArray, Float32Array] = _native.pack_records(
        positions, normals, origin, edge
    )
    return result


def unpack_records(
    records: Float32Array, counts: IntArray, corners: FloatArray, edge: float
) -> tuple[FloatArray, FloatArray]:
    """Return the positions and normals of points that were packed."""
    result: tuple[FloatArray, FloatArray] = _native.unpack_records(records, counts, corners, edge)
    return result


def unpack_within(
    records: Float32Array,
    counts: IntArray,
    corners: FloatArray,
    edge: float,
    low: FloatArray,
    high: FloatArray,
) -> tuple[FloatArray, IntArray]:
    """Return the packed positions in a box, and which they are."""
    result: tuple[FloatArray, IntArray] = _native.unpack_within(
        records, counts, corners, edge, low, high
    )
    return result


def count_packed(
    records: Float32Array,
    counts: IntArray,
    corners: FloatArray,
    edge: float,
    origin: FloatArray,
    cell_size: float,
) -> tuple[IntArray, IntArray]:
    """Count packed points in the occupied cells of a lattice."""
    result: tuple[IntArray, IntArray] = _native.count_packed(
        records, counts, corners, edge, origin, cell_size
    )
    return result


def sort_packed(
    records: Float32Array,
    counts: IntArray,
    corners: FloatArray,
    edge: float,
    origin: FloatArray,
    cell_size: float,
    depth: int,
    wanted: IntArray,
    numbers: ByteArray,
) -> tuple[IntArray, IntArray, Float32Array, NDArray[np.uint32], ByteArray]:
    """Sort packed points by the finest cell."""
    result: tuple[IntArray, IntArray, Float32Array, Blocks, ByteArray] = _native.sort_packed(
        records, counts, corners, edge, origin, cell_size, depth, wanted, numbers
    )
    return result


def place_packed(
    records: Float32Array,
    blocks: NDArray[np.uint32],
    corners: FloatArray,
    edge: float,
    origin: FloatArray,
    cell_size: float,
) -> tuple[FloatArray, FloatArray]:
    """Return packed points relative to the centres of their cells."""
    result: tuple[FloatArray, FloatArray] = _native.place_packed(
        records, blocks, corners, edge, origin, cell_size
    )
    return result


def seed_packed(
    records: Float32Array,
    blocks: NDArray[np.uint32],
    corners: FloatArray,
    edge: float,
    offsets: IntArray,
    wanted: BoolArray,
    grid: Grid,
) -> IntArray:
    """Return the bricks that hold a point in some cells."""
    held = (records, blocks, corners, edge, offsets, wanted)
    result: IntArray = _native.seed_packed(
        *held, grid.origin, BRICK * grid.step, _integers(grid.bricks)
    )
    return result


def keep_memory() -> None:
    """Have this process use memory that it has freed again, instead of giving it back."""
    _native.keep_memory()


def bound_free_memory(most_bytes: int) -> None:
    """Give the system back what memory is free, if it is more than this."""
    _native.bound_free_memory(most_bytes)


def _field_values(field: Field) -> tuple[Any, ...]:
    """Return a field as the seven values that the extension takes."""
    far = field.far
    levels = tuple(
        (_integers(level.keys), _singles(level.coefficients), _singles(level.trust))
        for level in field.levels
    )
    near = (_floats(field.origin), field.cell_size, levels)
    found = field.features
    features = () if found is None else (found.keys, found.pieces, found.joints)
    return (*near, far.values, _floats(far.origin), far.step, features)


def _grid_values(grid: Grid) -> tuple[Any, ...]:
    return _floats(grid.origin), grid.step, _integers(grid.bricks)
