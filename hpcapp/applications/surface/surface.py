"""What a method gives: a mesh in memory, or the parts of one.

Who may import it: the pipeline, the methods and the job.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from hpcapp.applications.surface.keeping import Keeping
from hpcapp.applications.surface.topology import Topology, check_mesh
from hpcapp.applications.surface.weld import WeldPlan, plan_weld
from hpcapp.applications.surface.welded import assemble_mesh, stream_mesh, stream_tiles
from hpcapp.io import TILES_SUFFIX, write_mesh, write_tiles
from hpccomponent.surface.mesh import Mesh
from hpccomponent.surface.mesh_part import MeshPart
from hpccomponent.surface.part_summary import PartSummary
from hpccomponent.surface.points import FloatArray

__all__ = ["PartSurface", "Surface", "WholeSurface"]


class Surface(Protocol):
    """A surface, wherever its vertices and faces are."""

    def check(self) -> Topology:
        """Judge its topology."""
        ...

    def share_outside(self, low: FloatArray, high: FloatArray) -> float:
        """Return the share of the vertices that lie outside a box, 0 to 1."""
        ...

    def mesh(self) -> Mesh:
        """Return all of it."""
        ...

    def write(self, path: Path) -> None:
        """Write it to a file, whose suffix chooses the format."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class WholeSurface:
    """A mesh in memory.

    Parameters
    ----------
    whole : Mesh
    """

    whole: Mesh

    def check(self) -> Topology:
        """Judge its topology."""
        return check_mesh(self.whole)

    def share_outside(self, low: FloatArray, high: FloatArray) -> float:
        """Return the share of the vertices that lie outside a box, 0 to 1."""
        return _count_outside(self.whole.vertices, low, high) / max(1, len(self.whole.vertices))

    def mesh(self) -> Mesh:
        """Return all of it."""
        return self.whole

    def write(self, path: Path) -> None:
        """Write it to a file, whose suffix chooses the format."""
        write_mesh(path, self.whole)


@dataclass(slots=True, eq=False)
class PartSurface:
    """A mesh in parts, in memory or kept elsewhere.

    Parameters
    ----------
    parts : list of MeshPart or str
        Those that are kept, by their names.
    summaries : list of PartSummary
        Of the parts.
    origin : ndarray of float64, shape (3,)
        Of the local frame that the parts' vertices are in.
    keeping : Keeping, optional
        Where parts are kept.
    """

    parts: list[MeshPart | str]
    summaries: list[PartSummary]
    origin: FloatArray
    keeping: Keeping | None = None
    _plan: WeldPlan | None = None

    @property
    def plan(self) -> WeldPlan:
        """How the parts become one mesh."""
        if self._plan is None:
            self._plan = plan_weld(self.summaries)
        return self._plan

    def load(self, index: int) -> MeshPart:
        """Return a part; the arrays of one that is kept in a folder stay there, mapped."""
        part = self.parts[index]
        if isinstance(part, MeshPart):
            return part
        assert self.keeping is not None  # noqa: S101 - or there would be no names
        return MeshPart.from_values(self.keeping.store.get(part)[0])

    def check(self) -> Topology:
        """Judge its topology."""
        return self.plan.topology

    def share_outside(self, low: FloatArray, high: FloatArray) -> float:
        """Return the share of the vertices that lie outside a box, 0 to 1."""
        if (self.plan.box[0] >= low).all() and (self.plan.box[1] <= high).all():
            return 0.0
        outside = total = 0
        for part in map(self.load, range(len(self.parts))):
            own = part.vertices[np.repeat(~part.guests, part.vertex_counts)]
            outside += _count_outside(own, low, high)
            total += len(own)
        return outside / max(1, total)

    def mesh(self) -> Mesh:
        """Return all of it."""
        return assemble_mesh(self.plan, self.load, self.origin)

    def write(self, path: Path) -> None:
        """Write it to a file, whose suffix chooses the format, block after block."""
        if path.suffix.lower() == TILES_SUFFIX:
            write_tiles(path, stream_tiles(self.plan, self.load, self.origin))
        else:
            write_mesh(path, stream_mesh(self.plan, self.load, self.origin))


def _count_outside(vertices: FloatArray, low: FloatArray, high: FloatArray) -> int:
    """Count the vertices outside a box, column by column: rows are slow to reduce."""
    outside = np.zeros(len(vertices), np.bool_)
    for axis, column in enumerate(vertices.T):
        outside |= (column < low[axis]) | (column > high[axis])
    return int(np.count_nonzero(outside))
