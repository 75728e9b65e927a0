"""The user's side: the command, the communicator and the master processes of applications.

From Python::

    mesh = hpcapp.reconstruct("scan.laz")
    mesh  # in a notebook it shows itself; mesh.show() opens a browser
    mesh.save("mesh.ply")
    mesh.report("report.html")

    with hpcapp.open_executor("cluster.yaml") as backend:
        backend.executor.submit(...)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcapp.api.awaiting import reconstruct_async
    from hpcapp.api.comparison import Comparison, compare, compare_epochs, measure_heaps
    from hpcapp.api.mesh import Mesh, read_mesh
    from hpcapp.api.reconstruction import reconstruct
    from hpcapp.api.sections import section
    from hpcapp.api.simulation import simulate
    from hpcapp.api.terrain import heights
    from hpcapp.applications.compare.volume.heap import Heap
    from hpcapp.applications.compare.volume.measure import Change, SolidChange
    from hpcapp.applications.heights.grid import HeightGrid
    from hpcapp.applications.section.sections import Sections
    from hpcapp.applications.surface.hierarchical.settings import Hierarchical
    from hpcapp.applications.surface.paper.settings import Paper
    from hpcapp.backends.selection import open_executor
    from hpcapp.cancellation import Cancellation
    from hpcapp.geometry.points import PointCloud
    from hpcapp.io import read_points, write_points
    from hpccomponent.errors import (
        HpcError,
        InputError,
        JobCancelledError,
        JobError,
        MissingLibraryError,
        OutputError,
        UsageError,
    )

__all__ = [
    "Cancellation",
    "Change",
    "Comparison",
    "Heap",
    "HeightGrid",
    "Hierarchical",
    "HpcError",
    "InputError",
    "JobCancelledError",
    "JobError",
    "Mesh",
    "MissingLibraryError",
    "OutputError",
    "Paper",
    "PointCloud",
    "Sections",
    "SolidChange",
    "UsageError",
    "compare",
    "compare_epochs",
    "heights",
    "measure_heaps",
    "open_executor",
    "read_mesh",
    "read_points",
    "reconstruct",
    "reconstruct_async",
    "section",
    "simulate",
    "write_points",
]

_ERRORS = "hpccomponent.errors"
_HOMES = {
    "hpcapp.api.awaiting": ("reconstruct_async",),
    "hpcapp.api.comparison": ("Comparison", "compare", "compare_epochs", "measure_heaps"),
    "hpcapp.api.mesh": ("Mesh", "read_mesh"),
    "hpcapp.api.reconstruction": ("reconstruct",),
    "hpcapp.api.sections": ("section",),
    "hpcapp.api.simulation": ("simulate",),
    "hpcapp.api.terrain": ("heights",),
    "hpcapp.applications.compare.volume.heap": ("Heap",),
    "hpcapp.applications.compare.volume.measure": ("Change", "SolidChange"),
    "hpcapp.applications.heights.grid": ("HeightGrid",),
    "hpcapp.applications.section.sections": ("Sections",),
    "hpcapp.applications.surface.hierarchical.settings": ("Hierarchical",),
    "hpcapp.applications.surface.paper.settings": ("Paper",),
    "hpcapp.geometry.points": ("PointCloud",),
    "hpcapp.backends.selection": ("open_executor",),
    "hpcapp.cancellation": ("Cancellation",),
    "hpcapp.io": ("read_points", "write_points"),
    _ERRORS: (
        "HpcError",
        "InputError",
        "JobCancelledError",
        "JobError",
        "MissingLibraryError",
        "OutputError",
        "UsageError",
    ),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is: ``import hpcapp`` must stay light."""
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    for one in {name, *_HOMES[_ERRORS]} - globals().keys():
        found = getattr(import_module(_HOME_OF[one]), one)
        found.__module__ = __name__  # by which its users know it, in tracebacks and pickles
        globals()[one] = found
    return globals()[name]


def __dir__() -> list[str]:
    """Name the interface, for completion in notebooks."""
    return sorted(__all__)
