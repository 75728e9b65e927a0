"""Who sees the folder of a cloud, and goes through it."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hpcapp.applications.surface.cloud.point_workers import PointWorkers
from hpcapp.backends.selection import Backend
from hpccomponent.files.private_files import make_private_folder


def all_see_folder(folder: Path, backend: Backend) -> bool:
    """Find out whether every worker sees a folder, and what this process writes into it."""
    if backend.is_here:
        return True
    with tempfile.NamedTemporaryFile(dir=folder) as sign:
        return backend.workforce.sees(Path(sign.name))


def find_point_workers(path: Path, folder: Path, backend: Backend, points: int) -> PointWorkers:
    """Find out who can go through a cloud in a folder.

    `path` is that of the input. The folder need not exist, the one around it is made; a task may
    hold about `points` at most.
    """
    if backend.is_here:
        return PointWorkers(backend.workforce, True, points)
    make_private_folder(folder.parent)
    with tempfile.NamedTemporaryFile(dir=folder.parent) as sign:
        sees_both = backend.workforce.sees(Path(sign.name), path)
    sees = sees_both or all_see_folder(folder.parent, backend)
    return PointWorkers(backend.workforce, sees, points, sees_both)
