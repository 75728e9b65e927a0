"""The surface inside the bricks of one tile, with what it shares with others named, not copied."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from hpcapp.applications.surface.types.result_patterns import LENGTH
from hpcapp.geometry.lattice import find_keys, number_keys
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray, Int32Array, IntArray
from hpcapp.kernels.types.brick_mesh import BrickMesh
from hpcapp.kernels.types.grid import OWN, BrickKinds
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.columns import Column
from hpccomponent.protocol.records import record

_ROWS_AT_ONCE = 1 << 17  # of what stands for a brick; no result depends on it
BrickKeys = Annotated[IntArray, Column("b", low=0, rises=True)]
BrickCounts = Annotated[Int32Array, Column("b", low=0)]
BrickFlags = Annotated[BoolArray, Column("b")]
ForeignBricks = Annotated[IntArray, Column("g", low=0)]
ForeignNumbers = Annotated[Int32Array, Column("g", low=0)]


@record("surface.part")
@dataclass(frozen=True, slots=True, eq=False)
class MeshPart:
    """The vertices and faces of some bricks; b bricks, v vertices, f faces, g foreign vertices.

    A vertex belongs to the brick of the lower node of its edge. What two parts share is
    bit-identical. A brick that some part owns is taken from there, else from the lowest-numbered
    part that has it as a guest; a face that refers to a vertex of another copy means the vertex of
    that number in the copy that is taken.
    """

    bricks: BrickKeys
    """Keys of places on the evaluation grid (see `lattice.pack_places`)."""
    guests: BrickFlags
    """A brick of another tile that this tile's surface reached, and whose owner may not know of
    it: it holds no point."""
    vertex_counts: BrickCounts
    """How many vertices each brick has."""
    face_counts: BrickCounts
    """How many faces each brick has."""
    vertices: Annotated[FloatArray, Column("v", 3, unit=LENGTH)]
    """Brick by brick, in their final places; in the local frame."""
    faces: Annotated[Int32Array, Column("f", 3)]
    """Brick by brick, anticlockwise as seen from outside: i >= 0 is a row of `vertices`, i < 0
    the foreign vertex ~i."""
    foreign_bricks: ForeignBricks
    """The brick of each foreign vertex, none of them in `bricks`."""
    foreign_numbers: ForeignNumbers
    """Its number within its brick; (brick, number) are sorted and unique."""
    supported: Annotated[BoolArray, Column("v")]
    """Vertices whose finest cell holds points."""

    @classmethod
    def empty(cls) -> MeshPart:
        """Return a part without bricks."""
        none = np.empty(0, np.int32)
        keys = np.empty(0, np.int64)
        places, corners = np.empty((0, 3)), np.empty((0, 3), np.int32)
        no = np.empty(0, np.bool_)
        return cls(keys, no, none, none, places, corners, keys, none, no)

    @classmethod
    def of_mesh(cls, mesh: Mesh) -> MeshPart:
        """Return a mesh that no grid has made: runs of its rows stand for bricks."""
        of_all = mesh.vertices, mesh.faces
        bricks = -(-max(map(len, of_all)) // _ROWS_AT_ONCE)
        ends = _ROWS_AT_ONCE * np.arange(bricks + 1)
        counts = [np.diff(np.minimum(ends, len(rows))).astype(np.int32) for rows in of_all]
        return replace(
            cls.empty(),
            bricks=np.arange(bricks),
            guests=np.zeros(bricks, np.bool_),
            vertex_counts=counts[0],
            face_counts=counts[1],
            vertices=mesh.vertices,
            faces=mesh.faces.astype(np.int32),
            supported=np.zeros(len(mesh.vertices), np.bool_),
        )


def cut_part(
    mesh: BrickMesh, kinds: BrickKinds | None = None, supported: BoolArray | None = None
) -> MeshPart:
    """Cut the rim off the surface of a tile; what its faces use of it is named.

    Without `kinds` all bricks that hold points are the tile's own; without `supported` (v,), of the
    mesh's vertices, none is (see `MeshPart`).
    """
    taken = mesh.taken  # (b,): bricks that are no rim
    bricks = mesh.bricks[taken]
    guests = np.zeros(len(bricks), np.bool_) if kinds is None else kinds.at(bricks) != OWN
    # (v,): the row that each vertex of the mesh has in the part, -1 where it belongs to the rim.
    is_inner = np.repeat(taken, mesh.vertex_counts)
    rows = np.cumsum(is_inner, dtype=np.int32) - np.int32(1)
    rows[~is_inner] = -1
    faces = mesh.faces.take(np.flatnonzero(np.repeat(taken, mesh.face_counts)), axis=0)
    corners = rows.take(faces)
    # Corners at the rim name the foreign vertices, which stand in the order of the mesh.
    outside = np.flatnonzero(corners < 0)
    outer, names = number_keys(faces.reshape(-1)[outside])
    corners.reshape(-1)[outside] = ~names
    inner = np.flatnonzero(is_inner)
    starts = np.cumsum(mesh.vertex_counts, dtype=np.int64) - mesh.vertex_counts
    owners = np.searchsorted(starts + mesh.vertex_counts, outer, side="right")
    return MeshPart(
        bricks,
        guests,
        mesh.vertex_counts[taken],
        mesh.face_counts[taken],
        mesh.vertices.take(inner, axis=0),
        corners,
        mesh.bricks[owners],
        (outer - starts[owners]).astype(np.int32),
        np.zeros(len(inner), np.bool_) if supported is None else supported[inner],
    )


def drop_faces(part: MeshPart, rows: IntArray) -> MeshPart:
    """Return a part without the faces of some rows (k,); it keeps all its vertices."""
    stays = np.ones(len(part.faces), np.bool_)
    stays[rows] = False
    ends = np.cumsum(part.face_counts)
    left = np.append(0, np.cumsum(stays))[ends]
    counts = np.diff(left, prepend=0).astype(np.int32)
    return replace(part, face_counts=counts, faces=part.faces[stays])


def join_parts(parts: list[MeshPart]) -> MeshPart:
    """Join parts that have no brick in common; what they use of one another is no longer foreign.

    They may be any number, in any order: the result is what `cut_part` makes of the surface in the
    bricks of all.
    """
    if len(parts) < 2:
        return parts[0] if parts else MeshPart.empty()
    parts = sorted(parts, key=lambda part: int(part.bricks[0]) if len(part.bricks) else 0)
    bricks = np.concatenate([part.bricks for part in parts])
    of_vertices = np.concatenate([part.vertex_counts for part in parts])
    # How the bricks are sorted, and the first vertex of each, part after part.
    order, starts = np.argsort(bricks, kind="stable"), np.cumsum(of_vertices) - of_vertices
    foreign_bricks, foreign_numbers, meant = _name_foreign(
        bricks[order],
        starts[order],
        np.concatenate([part.foreign_bricks for part in parts]),
        np.concatenate([part.foreign_numbers for part in parts]),
    )
    # (f, 3): each part's rows go behind those of the parts before it; its foreign vertices become
    # rows where another part has them.
    faces = np.concatenate([part.faces for part in parts])
    face, vertex, name = 0, 0, 0
    for part in parts:
        corners = faces[face : face + len(part.faces)].reshape(-1)
        outside = np.flatnonzero(corners < 0)
        named = meant[name : name + len(part.foreign_bricks)][~corners[outside]]
        corners += np.int32(vertex)
        corners[outside] = named
        face, vertex = face + len(part.faces), vertex + len(part.vertices)
        name += len(part.foreign_bricks)
    joined = MeshPart(
        bricks,
        np.concatenate([part.guests for part in parts]),
        of_vertices,
        np.concatenate([part.face_counts for part in parts]),
        np.concatenate([part.vertices for part in parts]),
        faces,
        foreign_bricks,
        foreign_numbers,
        np.concatenate([part.supported for part in parts]),
    )
    return joined if (bricks[1:] > bricks[:-1]).all() else _sort_bricks(joined, order)


def _sort_bricks(part: MeshPart, order: IntArray) -> MeshPart:
    """Return a part whose bricks are in some order with its bricks put into another one."""
    vertex_rows, face_rows = (
        _move_runs(counts, order) for counts in (part.vertex_counts, part.face_counts)
    )
    vertices, faces = np.empty_like(part.vertices), np.empty_like(part.faces)
    vertices[vertex_rows] = part.vertices
    supported = np.empty_like(part.supported)
    supported[vertex_rows] = part.supported
    names = np.arange(-len(part.foreign_bricks), 0, dtype=np.int32)  # they stay what they are
    faces[face_rows] = np.concatenate([vertex_rows, names])[part.faces]
    return replace(
        part,
        bricks=part.bricks[order],
        guests=part.guests[order],
        vertex_counts=part.vertex_counts[order],
        face_counts=part.face_counts[order],
        vertices=vertices,
        faces=faces,
        supported=supported,
    )


def _move_runs(counts: Int32Array, order: IntArray) -> Int32Array:
    """Return the row to which each row goes when runs of rows are put into an order."""
    starts, moved = np.cumsum(counts) - counts, np.empty(len(counts), np.int64)
    moved[order] = np.cumsum(counts[order]) - counts[order]
    rows: Int32Array = np.repeat(moved - starts, counts).astype(np.int32)
    rows += np.arange(len(rows), dtype=np.int32)
    return rows


def _name_foreign(
    bricks: IntArray, starts: IntArray, names: IntArray, numbers: Int32Array
) -> tuple[IntArray, Int32Array, Int32Array]:
    """Tell what the foreign vertices of some parts are to these parts joined.

    `bricks` (b,) are those of all, sorted, and `starts` (b,) the first vertex of each, wherever it
    lies; `names` (g,) the brick of each foreign vertex, and `numbers` (g,) its own within that.
    Returns brick and number of those that stay foreign, each once, and for all (g,) what the corner
    of a face says that means it.
    """
    at = find_keys(bricks, names)
    is_here = at < len(bricks)
    meant = np.empty(len(names), np.int32)
    meant[is_here] = starts[at[is_here]] + numbers[is_here]
    # The others, each once: sorted by brick and number, both in one integer.
    outer, owners = number_keys(names[~is_here])
    pairs, ranks = number_keys(owners << 32 | numbers[~is_here])
    meant[~is_here] = ~ranks
    return outer[pairs >> 32], (pairs & 0xFFFFFFFF).astype(np.int32), meant
