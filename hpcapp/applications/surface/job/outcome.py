"""What came of a job, before it is written."""

from __future__ import annotations

from typing import Any

from hpcapp.applications.surface.job.backend_choice import BackendChoice
from hpcapp.applications.surface.stitching.surface import Surface
from hpcapp.backends.selection import Backend
from hpccomponent.dataclass import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """A 0-level iso-surface, and how it came about.

    `points` were left after preprocessing; `facts` are what the method chose and found: ``patches``
    is always there.
    """

    surface: Surface
    points: int
    facts: dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What came of a job, while its backend, whose workers may write the mesh, is open.

    The `warnings` are logged already; `fine` is what the surface was before it was simplified,
    where a texture is made of it.
    """

    result: Reconstruction
    grid: int
    backend: Backend
    choice: BackendChoice
    warnings: list[str]
    fine: Surface | None = None
