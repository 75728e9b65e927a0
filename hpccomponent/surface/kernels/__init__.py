"""Every kernel of the default method, in the build that was chosen: C++ or numpy (see `build`).

Each function has its full description at its numpy version, which is imported only where it runs.
A kernel's row depends on no other row of its batch and on no number of threads; the two builds
agree to rounding, and workers of one job run the same one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.build import load_native
from hpccomponent.surface.extraction.bricks import BrickKinds
from hpccomponent.surface.extraction.case_table import case_triangles
from hpccomponent.surface.extraction.marching_cubes import BrickMesh
from hpccomponent.surface.fitting.field import BRICK, Field, Grid
from hpccomponent.surface.kernels.portable.connectivity import Survey
from hpccomponent.surface.kernels.portable.seams import BrickSums, Seams
from hpccomponent.surface.types.points import FloatArray, IntArray

__all__ = [
    "accumulate_moments",
    "balance_vertices",
    "bound_points",
    "corner_moments",
    "count_boxes",
    "count_cells",
    "evaluate_bricks",
    "evaluate_residuals",
    "find_keys",
    "find_seams",
    "fit_corners",
    "gather_points",
    "grow_surface",
    "inherit_level",
    "integrate_normals",
    "label_components",
    "merge_cells",
    "parent_keys",
    "poll_normals",
    "sample_boxes",
    "sample_corners",
    "sample_grid",
    "seed_bricks",
    "signed_volume",
    "sort_points",
    "spread_keys",
    "sum_bricks",
    "sum_neighbours",
    "survey_mesh",
    "unite_keys",
]

_native: Any = load_native()

Float32Array = NDArray[np.float32]
Int32Array = NDArray[np.int32]
ByteArray = NDArray[np.uint8]


def _floats(values: Any) -> FloatArray:
    return np.ascontiguousarray(values, np.float64)


def _singles(values: Any) -> Float32Array:
    return np.ascontiguousarray(values, np.float32)


def _integers(values: Any) -> IntArray:
    return np.ascontiguousarray(values, np.int64)


def bound_points(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the box around some points; see `spacing.bound_points`."""
    if _native is None:
        from hpccomponent.surface.cloud import spacing

        return spacing.bound_points(positions)
    bounds: tuple[FloatArray, FloatArray] = _native.bound_points(_floats(positions))
    return bounds


def count_boxes(
    positions: FloatArray, low: FloatArray, edge: float, one_in: int
) -> tuple[int, int]:
    """Count points and occupied boxes over a sample of the boxes; see `spacing.count_boxes`."""
    if _native is None:
        from hpccomponent.surface.cloud import spacing

        return spacing.count_boxes(positions, low, edge, one_in)
    counts: tuple[int, int] = _native.count_boxes(_floats(positions), _floats(low), edge, one_in)
    return counts


def sample_boxes(positions: FloatArray, low: FloatArray, edge: float, one_in: int) -> IntArray:
    """Return the points in a sample of boxes; see `spacing.sample_boxes`."""
    if _native is None:
        from hpccomponent.surface.cloud import spacing

        return spacing.sample_boxes(positions, low, edge, one_in)
    rows: IntArray = _native.sample_boxes(_floats(positions), _floats(low), edge, one_in)
    return rows


def sort_points(
    positions: FloatArray, origin: FloatArray, cell_size: float
) -> tuple[IntArray, IntArray, NDArray[np.uint32]]:
    """Sort points by the cell that they lie in; see `cells.sort_points`."""
    if _native is None:
        from hpccomponent.surface.kernels.portable import cells

        return cells.sort_points(positions, origin, cell_size)
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
    """Return some points relative to the centres of their cells; see `cells.gather_points`."""
    if _native is None:
        from hpccomponent.surface.kernels.portable import cells

        return cells.gather_points(positions, normals, rows, origin, cell_size)
    points = (_floats(positions), _floats(normals))
    result: tuple[FloatArray, FloatArray] = _native.gather_points(
        *points, rows, _floats(origin), cell_size
    )
    return result


def count_cells(
    positions: FloatArray, low: FloatArray, edge: float
) -> tuple[IntArray, IntArray, IntArray]:
    """Count the points in each occupied cell; see `outliers.count_cells`."""
    if _native is None:
        from hpccomponent.surface.cloud import outliers

        return outliers.count_cells(positions, low, edge)
    result: tuple[IntArray, IntArray, IntArray] = _native.count_cells(
        _floats(positions), _floats(low), edge
    )
    return result


def sum_neighbours(keys: IntArray, values: IntArray, wanted: IntArray) -> IntArray:
    """Sum values over the 27 cells around some cells; see `outliers.sum_neighbours`."""
    if _native is None:
        from hpccomponent.surface.cloud import outliers

        return outliers.sum_neighbours(keys, values, wanted)
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
    """Ask the neighbours of each point about its normal; see `normals.poll_normals`."""
    if _native is None:
        from hpccomponent.surface.normals import consistency as portable

        return portable.poll_normals(
            positions, _floats(normals), keys, cell_of, asked, reach, tolerance, drift
        )
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
    """Sum the moments of the points of each cell (a task); see `moments.accumulate_moments`."""
    if _native is None:
        from hpccomponent.surface.fitting import moments

        return moments.accumulate_moments(local_positions, normals, offsets, weights)
    kernel = _native.accumulate_moments if weights is None else _native.accumulate_weighted
    weighed = () if weights is None else (_floats(weights),)
    points = _floats(local_positions), _floats(normals), *weighed, _integers(offsets)
    result: FloatArray = kernel(*points, threads)
    return result


def merge_cells(cells: IntArray, moments: FloatArray) -> tuple[IntArray, FloatArray]:
    """Sum the moments of each eight children; see `cells.merge_cells`."""
    if _native is None:
        from hpccomponent.surface.kernels.portable import cells as portable

        return portable.merge_cells(cells, moments)
    result: tuple[IntArray, FloatArray] = _native.merge_cells(_integers(cells), _floats(moments))
    return result


def spread_keys(keys: IntArray, low: int, high: int) -> IntArray:
    """Return the places within a box around each place; see `lattice.spread_keys`."""
    if _native is None:
        from hpccomponent.surface.types import lattice

        return lattice.spread_keys(keys, low, high)
    result: IntArray = _native.spread_keys(_integers(keys), low, high)
    return result


def parent_keys(vertices: IntArray) -> IntArray:
    """Return every parent of some corners; see `cells.parent_keys`."""
    if _native is None:
        from hpccomponent.surface.kernels.portable import cells

        return cells.parent_keys(vertices)
    result: IntArray = _native.parent_keys(_integers(vertices))
    return result


def unite_keys(first: IntArray, second: IntArray) -> IntArray:
    """Return the union of two sorted sets of keys; see `lattice.unite_keys`."""
    if _native is None:
        from hpccomponent.surface.types import lattice

        return lattice.unite_keys(first, second)
    result: IntArray = _native.unite_keys(_integers(first), _integers(second))
    return result


def find_keys(keys: IntArray, wanted: IntArray, threads: int = 1) -> IntArray:
    """Return where each of some keys (v,) stands among sorted keys; see `lattice.find_keys`."""
    if _native is None:
        from hpccomponent.surface.types import lattice

        return lattice.find_keys(keys, wanted)
    result: IntArray = _native.find_keys(_integers(keys), _integers(wanted), threads)
    return result


def inherit_level(
    vertices: IntArray,
    parents: IntArray,
    coefficients: Float32Array,
    values: Float32Array,
    threads: int = 1,
) -> tuple[Float32Array, Float32Array]:
    """Return the means of the parents' quadrics and values; see `cells.inherit_level`."""
    if _native is None:
        from hpccomponent.surface.kernels.portable import cells

        return cells.inherit_level(vertices, parents, coefficients, values)
    keys = (_integers(vertices), _integers(parents))
    of_parents = (_singles(coefficients), _singles(values))
    result: tuple[Float32Array, Float32Array] = _native.inherit_level(*keys, *of_parents, threads)
    return result


def corner_moments(
    touched: IntArray, cells: IntArray, moments: FloatArray, threads: int = 1
) -> FloatArray:
    """Sum the moments of the eight cells around each corner; see `cells.corner_moments`."""
    if _native is None:
        from hpccomponent.surface.kernels.portable import cells as portable

        return portable.corner_moments(touched, cells, moments)
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
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Fit a quadric to the points around each corner (a task); see `cells.fit_corners`."""
    weights = (lam, least_mu, most_mu)
    if _native is None:
        from hpccomponent.surface.kernels.portable import cells as portable

        return portable.fit_corners(touched, cells, moments, prior, noise, *weights)
    keys = (_integers(touched), _integers(cells))
    values = (_floats(moments), _singles(prior), _singles(noise))
    result: tuple[Float32Array, Float32Array, Float32Array] = _native.fit_corners(
        *keys, *values, *weights, threads
    )
    return result


def evaluate_residuals(moments: FloatArray, coefficients: FloatArray | Float32Array) -> FloatArray:
    """Return the sum of f^2 at each vertex; see `hermite.evaluate_residuals`."""
    if _native is None:
        from hpccomponent.surface.fitting import hermite

        return hermite.evaluate_residuals(moments, _floats(coefficients))
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
    """Integrate normals that are spread on a grid; see `coarse_grid.integrate_normals`."""
    if _native is None:
        from hpccomponent.surface.kernels.portable import coarse_grid

        return coarse_grid.integrate_normals(places, normals, smoothing, held, nodes)
    samples = (_floats(places), _floats(normals))
    result: Float32Array = _native.integrate_normals(
        *samples, smoothing, _integers(held), nodes, threads
    )
    return result


def sample_grid(values: Float32Array, places: FloatArray) -> FloatArray:
    """Interpolate a grid trilinearly; see `coarse_grid.sample_grid`."""
    if _native is None:
        from hpccomponent.surface.kernels.portable import coarse_grid

        return coarse_grid.sample_grid(values, places)
    result: FloatArray = _native.sample_grid(values, _floats(places))
    return result


def sample_corners(
    values: Float32Array, keys: IntArray, origin: FloatArray, spacing: float
) -> FloatArray:
    """Interpolate a grid at the corners of a lattice; see `coarse_grid.sample_corners`."""
    if _native is None:
        from hpccomponent.surface.kernels.portable import coarse_grid

        return coarse_grid.sample_corners(values, keys, origin, spacing)
    result: FloatArray = _native.sample_corners(values, _integers(keys), _floats(origin), spacing)
    return result


def seed_bricks(grid: Grid, positions: FloatArray) -> IntArray:
    """Return the bricks that hold a point; see `bricks.seed_bricks`."""
    if _native is None:
        from hpccomponent.surface.extraction import bricks

        return bricks.seed_bricks(grid, positions)
    edge = BRICK * grid.step
    result: IntArray = _native.seed_bricks(
        _floats(positions), _floats(grid.origin), edge, _integers(grid.bricks)
    )
    return result


def evaluate_bricks(field: Field, grid: Grid, places: IntArray, threads: int = 1) -> Float32Array:
    """Evaluate the implicit function at the nodes of bricks; see `field.evaluate_bricks`."""
    if _native is None:
        from hpccomponent.surface.fitting import field as portable

        return portable.evaluate_bricks(field, grid, places)
    result: Float32Array = _native.evaluate_bricks(
        _field_values(field), *_grid_values(grid), _integers(places), threads
    )
    return result


def grow_surface(field: Field, grid: Grid, kinds: BrickKinds, threads: int = 1) -> BrickMesh:
    """Extract the surface that a tile reaches; see `extraction.grow_surface`."""
    if _native is None:
        from hpccomponent.surface.extraction import marching_cubes as extraction

        return extraction.grow_surface(field, grid, kinds)
    box = (_integers(kinds.first), np.ascontiguousarray(kinds.kinds, np.uint8))
    values = *_grid_values(grid), *box, case_triangles(), threads
    return BrickMesh(*_native.grow_surface(_field_values(field), *values))


def balance_vertices(vertices: FloatArray, faces: IntArray, step: float) -> FloatArray:
    """Move vertices so that the faces balance around the surface; see `extraction`."""
    if _native is None:
        from hpccomponent.surface.extraction import marching_cubes as extraction

        return extraction.balance_vertices(vertices, faces, step)
    result: FloatArray = _native.balance_vertices(_floats(vertices), _integers(faces), step)
    return result


def label_components(faces: IntArray, vertices: int) -> tuple[int, NDArray[np.int32]]:
    """Find the pieces of a mesh; see `connectivity.label_components`."""
    if _native is None:
        from hpccomponent.surface.kernels.portable import connectivity

        return connectivity.label_components(faces, vertices)
    result: tuple[int, NDArray[np.int32]] = _native.label_components(_integers(faces), vertices)
    return result


def survey_mesh(faces: IntArray, vertices: int) -> Survey:
    """Count what is to know about the edges of a mesh; see `connectivity.survey_mesh`."""
    if _native is None:
        from hpccomponent.surface.kernels.portable import connectivity

        return connectivity.survey_mesh(faces, vertices)
    return Survey(*_native.survey_mesh(_integers(faces), vertices))


def signed_volume(vertices: FloatArray, faces: IntArray, reference: FloatArray) -> float:
    """Return the volume inside a closed mesh; see `connectivity.signed_volume`."""
    if _native is None:
        from hpccomponent.surface.kernels.portable import connectivity

        return connectivity.signed_volume(vertices, faces, reference)
    return float(_native.signed_volume(_floats(vertices), _integers(faces), _floats(reference)))


def find_seams(
    faces: Int32Array, counts: tuple[int, int], vertex_of: Int32Array, is_open: NDArray[np.bool_]
) -> Seams:
    """Find the open vertices of a part; see `seams.find_seams`."""
    if _native is None:
        from hpccomponent.surface.kernels.portable import seams

        return seams.find_seams(faces, counts, vertex_of, is_open)
    return Seams(*_native.find_seams(faces, *counts, vertex_of, is_open))


def sum_bricks(
    vertices: FloatArray,
    faces: Int32Array,
    counts: tuple[Int32Array, Int32Array],
    labels: Int32Array,
    components: int,
) -> BrickSums:
    """Sum over what each brick holds; see `seams.sum_bricks`."""
    if _native is None:
        from hpccomponent.surface.kernels.portable import seams

        return seams.sum_bricks(vertices, faces, counts, labels, components)
    starts, entries, bounds = _native.sum_bricks(
        _floats(vertices), faces, *counts, labels, components
    )
    kinds, of_vertices, of_faces, sums = entries
    return BrickSums(starts, kinds, of_vertices, of_faces, sums, bounds)


def _field_values(field: Field) -> tuple[Any, ...]:
    """Return a field as the six values that the extension takes."""
    far = field.far
    levels = tuple(
        (_integers(level.keys), _singles(level.coefficients), _singles(level.trust))
        for level in field.levels
    )
    near = (_floats(field.origin), field.cell_size, levels)
    return (*near, far.values, _floats(far.origin), far.step)


def _grid_values(grid: Grid) -> tuple[Any, ...]:
    return _floats(grid.origin), grid.step, _integers(grid.bricks)
