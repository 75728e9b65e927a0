"""The user's side: the command, the communicator and the master processes of applications.

From Python::

    mesh = hpcapp.reconstruct(points, normals)
    mesh = hpcapp.reconstruct(hpcapp.read_points("scan.ply"))
    mesh.show()  # in a browser; a notebook shows it by itself
    hpcapp.write_mesh("mesh.ply", mesh)

    with hpcapp.open_executor("cluster.yaml") as backend:
        backend.executor.submit(...)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcapp.applications.surface.api import reconstruct
    from hpcapp.applications.surface.hierarchical.settings import Hierarchical
    from hpcapp.applications.surface.paper.settings import Paper
    from hpcapp.applications.surface.types.points import PointCloud
    from hpcapp.backends.selection import open_executor
    from hpcapp.io import read_points, write_mesh
    from hpcapp.pages.shown_mesh import Mesh, read_mesh

__all__ = [
    "Hierarchical",
    "Mesh",
    "Paper",
    "PointCloud",
    "open_executor",
    "read_mesh",
    "read_points",
    "reconstruct",
    "write_mesh",
]

_HOMES = {
    "Hierarchical": "hpcapp.applications.surface.hierarchical.settings",
    "Mesh": "hpcapp.pages.shown_mesh",
    "Paper": "hpcapp.applications.surface.paper.settings",
    "PointCloud": "hpcapp.applications.surface.types.points",
    "open_executor": "hpcapp.backends.selection",
    "read_mesh": "hpcapp.pages.shown_mesh",
    "read_points": "hpcapp.io",
    "reconstruct": "hpcapp.applications.surface.api",
    "write_mesh": "hpcapp.io",
}


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is: ``import hpcapp`` must stay light."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    """Name the interface, for completion in notebooks."""
    return sorted({*globals(), *__all__})
