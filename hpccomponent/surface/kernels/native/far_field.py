"""The field far from the points: normals integrated on a coarse grid."""

from __future__ import annotations

from hpccomponent.surface.kernels.native.arrays import floats, integers, native
from hpccomponent.surface.types.points import Float32Array, FloatArray, IntArray

__all__ = ["integrate_normals", "sample_corners", "sample_grid"]


def integrate_normals(
    places: FloatArray,
    normals: FloatArray,
    smoothing: float,
    held: IntArray,
    nodes: int,
    threads: int = 1,
) -> Float32Array:
    """Integrate normals that are spread on a grid."""
    samples = (floats(places), floats(normals))
    result: Float32Array = native.integrate_normals(
        *samples, smoothing, integers(held), nodes, threads
    )
    return result


def sample_grid(values: Float32Array, places: FloatArray) -> FloatArray:
    """Interpolate a grid trilinearly."""
    result: FloatArray = native.sample_grid(values, floats(places))
    return result


def sample_corners(
    values: Float32Array, keys: IntArray, origin: FloatArray, spacing: float
) -> FloatArray:
    """Interpolate a grid at the corners of a lattice."""
    result: FloatArray = native.sample_corners(values, integers(keys), floats(origin), spacing)
    return result
