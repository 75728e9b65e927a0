"""What a method gives: the parts of a mesh, in memory or kept elsewhere.

A mesh that was made as a whole is one part.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from hpcapp.applications.surface.attributes.carrying import NOTHING, Carrying
from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.extraction.summary import PartSummary, summarize_part
from hpcapp.applications.surface.stitching.assemble import (
    LoadPart,
    assemble_mesh,
    stream_mesh,
    stream_tiles,
    take_tile,
)
from hpcapp.applications.surface.stitching.plan import StitchingPlan, plan_stitching
from hpcapp.applications.surface.stitching.shared_ply import write_kept, write_part
from hpcapp.applications.surface.stitching.tile_ply import write_kept_tile
from hpcapp.applications.surface.stitching.topology import Topology, require_closed
from hpcapp.applications.surface.tiles.checkpoint import Checkpoint
from hpcapp.applications.surface.tiles.patterns import kept_part
from hpcapp.geometry.lattice import number_keys
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.io import describe_losses, needs_double, note_place, place_mesh, write_mesh
from hpcapp.io.crs import Crs
from hpcapp.io.meshes.mesh_stream import MeshStream
from hpcapp.io.registry import TILES_SUFFIX
from hpcapp.simplification.stream import simplify_stream
from hpcapp.simplification.target import Target
from hpcapp.workforce import Workforce, stream_batches
from hpccomponent.dataclass import dataclass
from hpccomponent.files.held_folders import temporary_folder
from hpccomponent.protocol.declared import ANYTHING, Fixed
from hpccomponent.runtime.background import Deferred
from hpccomponent.store.base import FolderStore

log = logging.getLogger("hpcapp")


@dataclass(slots=True, eq=False)
class Surface:
    """A mesh in parts, in memory or kept elsewhere.

    Parts that `checkpoint` keeps are named; `workers` made them, None where that is not known.
    Their vertices are in the local frame of `origin` (3,). `crumb` and `points` are for
    `plan_stitching`; `taken` counts the parts that jobs of other scans had made.
    """

    parts: list[MeshPart | str]
    summaries: list[PartSummary]
    origin: FloatArray
    checkpoint: Checkpoint | None = None
    workers: list[str | None] = field(default_factory=list)
    crumb: int | None = None
    points: int | None = None
    taken: int = 0
    _plan: StitchingPlan | None = None
    _topology: Deferred[Topology] | None = None
    _checked: set[int] = field(default_factory=set)

    @classmethod
    def of_mesh(cls, mesh: Mesh) -> Surface:
        """Return a mesh as a surface of one part, without vertices that no face uses."""
        part = MeshPart.of_mesh(mesh)
        return cls([part], [summarize_part(part)], mesh.origin, crumb=0)

    @property
    def is_here(self) -> bool:
        """Whether its parts are in this process, so that looking at it costs no fetching."""
        return self.checkpoint is None

    @property
    def plan(self) -> StitchingPlan:
        """How the parts become one mesh."""
        if self._plan is None:
            self._plan = plan_stitching(self.summaries, self.crumb, self.points)
        return self._plan

    def load(self, index: int) -> MeshPart:
        """Return a part; the arrays of one that is kept in a folder stay there, mapped.

        JobError where what is kept is damaged, or not what its summary says.
        """
        part = self.parts[index]
        if isinstance(part, MeshPart):
            return part
        assert self.checkpoint is not None  # noqa: S101 - or there would be no names
        if index in self._checked:
            return cast(MeshPart, self.checkpoint.store.get(part)[0])
        declared = Fixed(kept_part(self.summaries[index]), ANYTHING, ANYTHING)
        kept: MeshPart = self.checkpoint.get(part, declared)[0]
        self._checked.add(index)
        return kept

    def only(self, components: IntArray) -> Surface:
        """Return some of the pieces (k,) of its plan alone: see `StitchingPlan.pieces`."""
        return replace(self, _plan=self.plan.only(components), _topology=None)

    def check(self) -> Topology:
        """Judge its topology."""
        if self._topology is None:
            self._topology = Deferred(self.plan.judge)
        return self._topology()

    @contextmanager
    def open_stream(self) -> Iterator[MeshStream]:
        """Yield its vertices and faces, block after block, in the local frame."""
        with self.fetched() as load:
            yield stream_mesh(self.plan, load, self.origin)

    def share_outside(self, low: FloatArray, high: FloatArray) -> float:
        """Return the share of the vertices, 0 to 1, that lie outside a box in the local frame."""
        if (self.plan.box[0] >= low).all() and (self.plan.box[1] <= high).all():
            return 0.0
        mesh = stream_mesh(self.plan, self.load, self.origin)  # a part has more than it gives
        outside = sum(_count_outside(block.positions, low, high) for block in mesh.vertices())
        return outside / max(1, mesh.vertex_count)

    def stream(self) -> MeshStream:
        """Return it block by block, as it may not fit into memory."""
        return stream_mesh(self.plan, self.load, self.origin)

    def owners(self) -> IntArray | None:
        """Return which part each vertex is from, shape (v,), as in `stream`; None of one part."""
        if len(self.parts) == 1:
            return None
        parts = self.plan.bricks.part_of(self.plan.bricks.taken).astype(np.int32)
        return np.repeat(parts, np.diff(self.plan.vertex_starts))

    def makers(self) -> list[str]:
        """Return the worker that made each part; empty where it is not known of all."""
        known = [name for name in self.workers if name is not None]
        return known if len(known) == len(self.parts) else []

    def mesh(self, carrying: Carrying = NOTHING) -> Mesh:
        """Return all of it, with what its vertices carry."""
        return carrying.to_mesh(assemble_mesh(self.plan, self.load, self.origin))

    def write(self, path: Path, workforce: Workforce, carrying: Carrying = NOTHING) -> None:
        """Write it to a file, whose suffix chooses the format.

        Workers write their parts of a PLY, or their tiles, themselves where they have put their
        parts away themselves, and the topology is judged meanwhile; what they do not see, every
        other format, and vertices that carry something are written here. OutputError where the
        suffix is unknown, or the file cannot be written.
        """
        suffix = path.suffix.lower()
        is_shared = self.checkpoint is not None and self.checkpoint.is_shared
        is_plain = not carrying.is_something and not carrying.placement.is_asked
        if suffix in (".ply", TILES_SUFFIX) and is_shared and is_plain:
            assert self.checkpoint is not None  # noqa: S101 - it is shared
            self._topology = self._topology or workforce.defer(self.plan.judge)
            write = self._share_ply if suffix == ".ply" else self._share_tiles
            write(path, workforce, self.checkpoint.place, carrying.crs)
            return
        with self.fetched() as load:
            if suffix == TILES_SUFFIX:
                from hpcapp.io.meshes.tiles import write_tiles

                placement = carrying.placement
                whole = place_mesh(path, carrying.to_stream(self.stream()), placement)
                for loss in describe_losses(path, whole):
                    log.warning("warning: %s", loss)
                tiles = (
                    (index, place_mesh(path, carrying.to_tile(tile), placement))
                    for index, tile in stream_tiles(self.plan, load, self.origin)
                )
                write_tiles(path, tiles)
                note_place(path, whole)
            else:
                mesh = carrying.to_stream(stream_mesh(self.plan, load, self.origin))
                write_mesh(path, mesh, carrying.placement)

    @contextmanager
    def fetched(self) -> Iterator[LoadPart]:
        """Yield what loads a part at little cost, again and again: from a bucket they are fetched.

        A block of the mesh needs a little of many parts.
        """
        if self.checkpoint is None or self.checkpoint.is_folder:
            yield self.load
            return
        with temporary_folder() as folder:
            near = FolderStore(folder)
            for index in range(len(self.parts)):
                near.put(str(index), self.load(index))
            yield lambda index: cast(MeshPart, near.get(str(index)))

    def _share_ply(self, path: Path, workforce: Workforce, place: str, crs: Crs) -> None:
        """Let the workers write a PLY."""
        from hpcapp.io.ply.format import shared_ply

        plan = self.plan
        counts = (plan.vertex_count, plan.face_count)
        with shared_ply(path, counts, self.origin, plan.box, crs) as shared:
            batches = (
                ((place, name), plan.places(index), shared) for index, name in enumerate(self.parts)
            )
            for index in _left_undone(workforce, write_kept, batches):
                write_part(self.load(index), plan.places(index), shared)

    def _share_tiles(self, path: Path, workforce: Workforce, place: str, crs: Crs) -> None:
        """Let the workers write a folder of tiles."""
        from hpcapp.io.meshes.tiles import shared_tiles
        from hpcapp.io.ply.comments import keep

        plan = self.plan
        is_double, comments = needs_double(plan.box, self.origin), tuple(keep(crs))
        with shared_tiles(path) as file_of:

            def batch(index: int) -> tuple[Any, ...]:
                foreign = np.arange(len(plan.summaries[index].foreign_bricks))
                parts, rows = plan.locate_foreign(index, foreign)
                near, owners = number_keys(parts)
                names = tuple(self.parts[part] for part in near.tolist())
                file = (str(file_of(index)), str(path), is_double, self.origin, comments)
                return (place, self.parts[index]), plan.places(index), (names, owners, rows), file

            batches = map(batch, range(len(self.parts)))
            for index in _left_undone(workforce, write_kept_tile, batches):
                tile = take_tile(plan, self.load, self.origin, index)
                if tile.face_count:
                    write_mesh(file_of(index), replace(tile, crs=crs))


def simplify_surface(surface: Surface, target: Target) -> Surface:
    """Make a surface of fewer faces from one that, in parts, may be larger than memory.

    The bits are the same, wherever its parts are and however many. UsageError as of `Target.check`,
    JobError as of `require_closed`.
    """
    with surface.open_stream() as stream:
        light = Surface.of_mesh(simplify_stream(stream, target))
    require_closed(surface.check, light.check())
    return light


def _left_undone(
    workforce: Workforce, task: Callable[..., bool], batches: Iterable[tuple[Any, ...]]
) -> Iterator[int]:
    """Run a task for each part, and yield those that a worker could not write."""
    for index, is_written in stream_batches(workforce, task, batches, 2 * workforce.workers):
        if not is_written:
            yield index


def _count_outside(vertices: FloatArray, low: FloatArray, high: FloatArray) -> int:
    """Count the vertices outside a box, column by column: rows are slow to reduce."""
    outside = np.zeros(len(vertices), np.bool_)
    for axis, column in enumerate(vertices.T):
        outside |= (column < low[axis]) | (column > high[axis])
    return int(np.count_nonzero(outside))
