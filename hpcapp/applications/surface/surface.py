"""What a method gives: a mesh in memory, or the parts of one.

Who may import it: the pipeline, the methods and the job.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

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
    """A mesh in parts.

    Parameters
    ----------
    parts : list of MeshPart
    summaries : list of PartSummary
        Of the parts.
    origin : ndarray of float64, shape (3,)
        Of the local frame that the parts' vertices are in.
    """

    parts: list[MeshPart]
    summaries: list[PartSummary]
    origin: FloatArray
    _plan: WeldPlan | None = field(default=None)

    @property
    def plan(self) -> WeldPlan:
        """How the parts become one mesh."""
        if self._plan is None:
            self._plan = plan_weld(self.summaries)
        return self._plan

    def check(self) -> Topology:
        """Judge its topology."""
        return self.plan.topology

    def share_outside(self, low: FloatArray, high: FloatArray) -> float:
        """Return the share of the vertices that lie outside a box, 0 to 1."""
        outside = sum(_count_outside(part.vertices, low, high) for part in self.parts)
        return outside / max(1, sum(len(part.vertices) for part in self.parts))

    def mesh(self) -> Mesh:
        """Return all of it."""
        return assemble_mesh(self.plan, self.parts.__getitem__, self.origin)

    def write(self, path: Path) -> None:
        """Write it part by part: to a file, or to a folder of tiles, as the suffix says."""
        parts = self.parts.__getitem__
        if path.suffix.lower() == TILES_SUFFIX:
            write_tiles(path, stream_tiles(self.plan, parts, self.origin))
        else:
            write_mesh(path, stream_mesh(self.plan, parts, self.origin))


def _count_outside(vertices: FloatArray, low: FloatArray, high: FloatArray) -> int:
    """Count the vertices outside a box, column by column: rows are slow to reduce."""
    outside = np.zeros(len(vertices), np.bool_)
    for axis, column in enumerate(vertices.T):
        outside |= (column < low[axis]) | (column > high[axis])
    return int(np.count_nonzero(outside))
