"""Meshes: their pieces, edges, seams and sums."""

from __future__ import annotations

from hpccomponent.surface.kernels.native.arrays import floats, integers, native
from hpccomponent.surface.types.mesh import BrickSums, Seams, Survey
from hpccomponent.surface.types.points import BoolArray, FloatArray, Int32Array, IntArray

__all__ = ["find_seams", "label_components", "signed_volume", "sum_bricks", "survey_mesh"]


def label_components(faces: IntArray, vertices: int) -> tuple[int, Int32Array]:
    """Find the pieces of a mesh."""
    result: tuple[int, Int32Array] = native.label_components(integers(faces), vertices)
    return result


def survey_mesh(faces: IntArray, vertices: int) -> Survey:
    """Count what is to know about the edges of a mesh."""
    return Survey(*native.survey_mesh(integers(faces), vertices))


def signed_volume(vertices: FloatArray, faces: IntArray, reference: FloatArray) -> float:
    """Return the volume inside a closed mesh."""
    return float(native.signed_volume(floats(vertices), integers(faces), floats(reference)))


def find_seams(
    faces: Int32Array, counts: tuple[int, int], vertex_of: Int32Array, is_open: BoolArray
) -> Seams:
    """Find the open vertices of a part."""
    return Seams(*native.find_seams(faces, *counts, vertex_of, is_open))


def sum_bricks(
    vertices: FloatArray,
    faces: Int32Array,
    counts: tuple[Int32Array, Int32Array],
    labels: Int32Array,
    components: int,
) -> BrickSums:
    """Sum over what each brick holds."""
    starts, entries, bounds = native.sum_bricks(
        floats(vertices), faces, *counts, labels, components
    )
    kinds, of_vertices, of_faces, sums = entries
    return BrickSums(starts, kinds, of_vertices, of_faces, sums, bounds)
