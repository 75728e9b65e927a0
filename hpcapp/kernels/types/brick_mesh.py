"""Triangle meshes in memory."""

from __future__ import annotations

from hpcapp.geometry.points import BoolArray, FloatArray, Int32Array, IntArray
from hpccomponent.dataclass import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class BrickMesh:
    """The surface in some bricks.

    Parameters
    ----------
    bricks : ndarray of int64, shape (b,)
        Sorted keys.
    taken : ndarray of bool, shape (b,)
        False for the rim: its outer faces may be missing.
    vertex_counts, face_counts : ndarray of int32, shape (b,)
        Of each brick.
    vertices : ndarray of float64, shape (v, 3)
        Brick after brick, in length units of the input.
    faces : ndarray of int64, shape (f, 3)
        Brick after brick, rows of `vertices`, anticlockwise as seen from outside (positive).
    exits : ndarray of int64, shape (e,)
        Sorted keys of the bricks beyond that the surface reaches, and no tile has.
    """

    bricks: IntArray
    taken: BoolArray
    vertex_counts: Int32Array
    face_counts: Int32Array
    vertices: FloatArray
    faces: IntArray
    exits: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What `survey_mesh` counts.

    There are so many `boundary` edges with one face and `overfull` ones with more than two,
    `degenerate` ones from a vertex to itself, and `misoriented` ones that are run through twice in
    one direction. `fans` are pieces that the corners of all faces form when joined across shared
    edges; `edges_of` (v,) are the edges of which each vertex is the lower end.
    """

    boundary: int
    overfull: int
    degenerate: int
    misoriented: int
    fans: int
    edges_of: Int32Array


@dataclass(frozen=True, slots=True, eq=False)
class Seams:
    """What `find_seams` found.

    Parameters
    ----------
    components : int
        Pieces of the part that share no vertex.
    labels : ndarray of int32, shape (v,)
        The component of each vertex, numbered in the order of their first vertices.
    pieces : ndarray of int32, shape (p,)
        The node of each piece of corners, sorted; pieces of a node by their first corner.
    sides : ndarray of int32, shape (q, 3)
        Sides between open nodes (side s of face s // 3 runs from its corner s % 3 to the next),
        sorted, with the pieces of the corners at their two ends.
    bare : ndarray of int32, shape (m,)
        Nodes that are not open beforehand, and have no face.
    """

    components: int
    labels: Int32Array
    pieces: Int32Array
    sides: Int32Array
    bare: Int32Array


@dataclass(frozen=True, slots=True, eq=False)
class BrickSums:
    """What `sum_bricks` found: an entry is a component in a brick.

    Parameters
    ----------
    starts : ndarray of int32, shape (b + 1,)
        Where each brick's entries begin; they are sorted by the first vertex in the brick, then
        by the first face.
    labels, vertices, faces : ndarray of int32, shape (e,)
        The component, and how many of the brick's vertices and faces belong to it.
    sums : ndarray of float64, shape (e, 5)
        Over its faces: six times the signed volume, seen from the local frame's zero; over its
        vertices: the positions (3); over its faces: the area. A face with a foreign vertex does not
        count.
    bounds : ndarray of float64, shape (c, 6)
        Lowest and highest coordinates of each component's own vertices; infinite without any.
    """

    starts: Int32Array
    labels: Int32Array
    vertices: Int32Array
    faces: Int32Array
    sums: FloatArray
    bounds: FloatArray
