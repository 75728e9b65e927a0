"""The mesh that parts are: in memory, in blocks for a file, or tile by tile.

Parts come from a callable, one at a time and more than once: they may be in memory, or arrays on
disk that are mapped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np

from hpcapp.applications.surface.extraction.part_places import (
    PartPlaces,
    find_kept,
    place_faces,
    place_vertices,
)
from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.stitching.plan import StitchingPlan
from hpcapp.applications.surface.stitching.tile_ply import cut_tile
from hpcapp.cancellation import check_cancelled
from hpcapp.geometry.lattice import unique_keys
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, Int32Array, IntArray, PointCloud
from hpcapp.io import MeshStream

LoadPart = Callable[[int], MeshPart]

_ROWS_AT_ONCE = 1 << 17


def assemble_mesh(plan: StitchingPlan, load: LoadPart, origin: FloatArray) -> Mesh:
    """Put the whole mesh together in memory; `load` returns the part of an index.

    `origin` (3,) is of the local frame that the parts' vertices are in.
    """
    vertices = np.empty((plan.vertex_count, 3))
    faces = np.empty((plan.face_count, 3), np.int64)
    for index in range(len(plan.summaries)):
        check_cancelled()
        part, places = load(index), plan.places(index)
        bricks = np.flatnonzero(places.face_starts >= 0)
        found, runs = place_vertices(part, places, bricks)
        runs.put(found, vertices)
        _, corners, runs = place_faces(part, places, bricks)
        runs.put(corners, faces)
    return Mesh(vertices, faces, origin)


def stream_mesh(plan: StitchingPlan, load: LoadPart, origin: FloatArray) -> MeshStream:
    """Return the mesh as blocks in the order of the bricks; `load` is called again for each.

    A block at a time is in memory, and what the plan knows of the bricks.
    """
    blocks = Blocks(plan, load)
    return MeshStream(
        plan.vertex_count,
        plan.face_count,
        origin,
        plan.box,
        blocks.vertices,
        blocks.faces,
        blocks.corners,
    )


def stream_tiles(
    plan: StitchingPlan, load: LoadPart, origin: FloatArray
) -> Iterator[tuple[int, MeshStream]]:
    """Yield the mesh tile by tile: what each part with faces gives to it, and the part's index.

    Vertices on a seam are in each of its tiles, at the very same place.
    """
    for index in range(len(plan.summaries)):
        tile = take_tile(plan, load, origin, index)
        if tile.face_count:
            yield index, tile


def take_tile(plan: StitchingPlan, load: LoadPart, origin: FloatArray, index: int) -> MeshStream:
    """Return one of the tiles of `stream_tiles`, which may have no faces."""
    vertices, faces = cut_tile(
        load(index),
        plan.places(index),
        lambda foreign: _positions(plan, load, index, ~foreign),
    )
    return _whole(Mesh(vertices, faces, origin), plan.box)


def _whole(mesh: Mesh, box: FloatArray) -> MeshStream:
    """Return a mesh as one block, to be written as precisely as all that lies in a box."""
    return MeshStream(
        len(mesh.vertices),
        len(mesh.faces),
        mesh.origin,
        box,
        lambda: iter([PointCloud(mesh.vertices)]),
        lambda: iter([mesh.faces]),
        lambda: iter([mesh.vertices[mesh.faces]]),
    )


def _positions(
    plan: StitchingPlan, load: LoadPart, index: int, vertices: IntArray | Int32Array
) -> FloatArray:
    """Return where vertices of a part are, as `MeshPart.faces` names them; foreign ones, too."""
    positions = np.empty((len(vertices), 3))
    own = vertices >= 0
    positions[own] = load(index).vertices[vertices[own]]
    owners, rows = plan.locate_foreign(index, ~vertices[~own])
    foreign = np.flatnonzero(~own)
    # Part by part, as each may have to be read.
    for owner in unique_keys(owners).tolist():
        there = owners == owner
        positions[foreign[there]] = load(owner).vertices[rows[there]]
    return positions


class Blocks:
    """The bricks of all parts, in the order of their keys: all of them in blocks, or some.

    A part is loaded again for every block.
    """

    def __init__(self, plan: StitchingPlan, load: LoadPart) -> None:
        self.plan = plan
        self.load = load
        self._places: dict[int, PartPlaces] = {}  # grows with the bricks, like the plan

    def vertices(self) -> Iterator[PointCloud]:
        """Yield the vertices of the mesh, block after block."""
        for first, last in _cut(self.plan.vertex_starts):
            # (m, 3): the rows of a run of bricks, which several parts may give.
            start = int(self.plan.vertex_starts[first])
            block = np.empty((int(self.plan.vertex_starts[last] - start), 3))
            for index, bricks in self.plan.givers(np.arange(first, last)):
                found, runs = place_vertices(self.load(index), self._places_of(index), bricks)
                runs.put(found, block, start)
            yield PointCloud(block)

    def faces(self) -> Iterator[IntArray]:
        """Yield the faces of the mesh, as it numbers its vertices, shape (m, 3) each."""
        for first, last in _cut(self.plan.face_starts):
            start = int(self.plan.face_starts[first])
            block = np.empty((int(self.plan.face_starts[last] - start), 3), np.int64)
            for index, bricks in self.plan.givers(np.arange(first, last)):
                _, found, runs = place_faces(self.load(index), self._places_of(index), bricks)
                runs.put(found, block, start)
            yield block

    def corners(self) -> Iterator[FloatArray]:
        """Yield where the vertices of each face are, shape (m, 3, 3) each."""
        for first, last in _cut(self.plan.face_starts):
            start = int(self.plan.face_starts[first])
            block = np.empty((int(self.plan.face_starts[last] - start), 3, 3))
            for index, bricks in self.plan.givers(np.arange(first, last)):
                faces, _, runs = place_faces(self.load(index), self._places_of(index), bricks)
                found = _positions(self.plan, self.load, index, faces.reshape(-1))
                runs.put(found.reshape(-1, 3, 3), block, start)
            yield block

    def take_faces(self, bricks: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
        """Return the faces in some bricks, which are named by sorted rows of the plan's, (k,).

        These are the faces' rising rows in the mesh (f,), the faces as the mesh numbers their
        vertices (f, 3), and where these are (f, 3, 3).
        """
        count = int((self.plan.face_starts[bricks + 1] - self.plan.face_starts[bricks]).sum())
        rows, faces = np.empty(count, np.int64), np.empty((count, 3), np.int64)
        corners, end = np.empty((count, 3, 3)), 0
        for index, mine in self.plan.givers(bricks):
            named, found, runs = place_faces(self.load(index), self._places_of(index), mine)
            start, end = end, end + len(found)
            rows[start:end] = np.repeat(runs.numbers - runs.starts[:-1], np.diff(runs.starts))
            rows[start:end] += np.arange(len(found))
            faces[start:end] = found
            places = _positions(self.plan, self.load, index, named.reshape(-1))
            corners[start:end] = places.reshape(-1, 3, 3)
        order = np.argsort(rows)
        return rows[order], faces[order], corners[order]

    def find_faces(self, rows: IntArray) -> tuple[IntArray, IntArray]:
        """Return the bricks that faces of the mesh are in, and their numbers there.

        The faces (k,) are rising rows of the mesh, the bricks rows of the plan's.
        """
        bricks = np.searchsorted(self.plan.face_starts, rows, side="right") - 1
        numbers = rows - self.plan.face_starts[bricks]
        for index, mine in self.plan.givers(unique_keys(bricks)):
            part, first = self.load(index), self.plan.bricks.parts[index]
            for brick in mine.tolist():
                stays = find_kept(part, self._places_of(index), brick)
                here = bricks == self.plan.bricks.place[first + brick]
                numbers[here] = stays[numbers[here]]
        return bricks, numbers

    def find_vertices(self, rows: IntArray) -> tuple[IntArray, IntArray]:
        """Return the bricks that vertices of the mesh are in, and their numbers there.

        The vertices (k,) are rising rows of the mesh, the bricks rows of the plan's.
        """
        bricks = np.searchsorted(self.plan.vertex_starts, rows, side="right") - 1
        numbers = rows - self.plan.vertex_starts[bricks]
        for brick in unique_keys(bricks).tolist():
            copy, here = self.plan.bricks.taken[brick], bricks == brick
            every = np.arange(self.plan.bricks.vertex_counts[copy])
            labels = self.plan.bricks.labels_at(np.full(len(every), copy), every)
            numbers[here] = every[self.plan.kept[labels]][numbers[here]]
        return bricks, numbers

    def _places_of(self, index: int) -> PartPlaces:
        if index not in self._places:
            self._places[index] = self.plan.places(index)
        return self._places[index]


def _cut(starts: IntArray) -> Iterator[tuple[int, int]]:
    """Cut bricks into runs of so many rows, one brick more or less, without empty ones."""
    # (k,): the first brick at or behind every so many rows; the last edge, before empty bricks.
    marks = np.searchsorted(starts, np.arange(0, starts[-1], _ROWS_AT_ONCE))
    edges = unique_keys(np.append(marks, np.searchsorted(starts, starts[-1])))
    for first, last in pairwise(edges.tolist()):
        check_cancelled()
        yield first, last
