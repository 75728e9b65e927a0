"""What another run of a job has left of its points, and what this one leaves."""

from __future__ import annotations

import logging
import os
from dataclasses import asdict
from pathlib import Path

from hpcapp.applications.surface.cleaning.drive import Cleaned
from hpcapp.applications.surface.cloud.folder.disk import open_disk_cloud
from hpcapp.applications.surface.job.columns import CarriedColumns
from hpcapp.applications.surface.job.scan import Loaded, PointFolder
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.normals.oriented import Oriented
from hpcapp.applications.surface.tiles.checkpoint import POINTS_NOTE
from hpcapp.geometry.validity import Dropped
from hpcapp.io import PointSource
from hpcapp.io.points.point_source import Findings
from hpccomponent.errors import JobError
from hpccomponent.store.base import FolderStore
from hpccomponent.store.value import DamagedError

log = logging.getLogger("hpcapp")

_NOTE = POINTS_NOTE[-1]


def note_loaded(loaded: Loaded, folder: PointFolder) -> None:
    """Keep what is known of the points beside them, for a job that goes on from there."""
    known = {
        "cloud": Path(str(loaded.cloud.place)).name,
        "dropped": asdict(loaded.dropped),
        "cleaned": asdict(loaded.cleaned),
        "findings": asdict(loaded.findings),
        "oriented": asdict(loaded.oriented),
    }
    FolderStore(folder.path).put(_NOTE, known)


def find_loaded(settings: JobSettings, source: PointSource, folder: PointFolder) -> Loaded | None:
    """Return the points that another run has put into a folder; None if they are not whole."""
    try:
        os.lstat(folder.path / _NOTE)
    except FileNotFoundError:  # it did not come so far
        return None
    except OSError as error:
        log.warning("warning: %s: %s: the points are read again", folder.path, error.strerror)
        return None
    try:
        known = FolderStore(folder.path).get(_NOTE)
        cloud = open_disk_cloud(folder.path / known["cloud"])
        cloud.check()
    except (JobError, DamagedError) as error:
        problem = error.problem if isinstance(error, JobError) else str(error)
        log.warning("warning: %s: the points are read again", problem)
        return None
    return Loaded(
        cloud,
        Dropped(**known["dropped"]),
        Cleaned(**known["cleaned"]),
        CarriedColumns.of_file(settings, source),
        Oriented.of(known["oriented"]),
        Findings(**known["findings"]),
        source.frame,
    )
