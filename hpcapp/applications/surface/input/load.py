"""A cloud from its file to what the methods take: in memory, or in a folder."""

from __future__ import annotations

import logging
import os
import secrets
import shutil
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np

from hpcapp.applications.surface.checkpoint import POINTS_NOTE
from hpcapp.applications.surface.input.clean import Cleaned, clean_cloud, drop_far, drop_repeated
from hpcapp.applications.surface.input.ingest import ingest_file
from hpcapp.applications.surface.input.sides import (
    FROM_FILE,
    Oriented,
    is_contradicting,
    is_contradicting_there,
)
from hpcapp.applications.surface.scans import Passes, measure_spacing
from hpcapp.applications.surface.settings import JobSettings, Settings
from hpcapp.io import PointSource, drop_unusable, open_points, read_whole
from hpcapp.io.points.point_source import Findings
from hpcapp.io.points.usable import Dropped, refuse_too_few
from hpcapp.progress import StageClock
from hpccomponent.errors import JobError
from hpccomponent.files.private_files import make_private_folder, remove_path
from hpccomponent.store.base import FolderStore
from hpccomponent.store.value import DamagedError
from hpccomponent.surface.attributes.labels import find_labels
from hpccomponent.surface.cloud.arranged import ArrangedCloud, MemoryCloud, arrange_cloud
from hpccomponent.surface.cloud.disk import DiskCloud, open_disk_cloud
from hpccomponent.surface.types.points import FloatArray, PointCloud

__all__ = [
    "Loaded",
    "arrange_usable",
    "clean_points",
    "load_folder",
    "load_memory",
    "orient_points",
]

log = logging.getLogger("hpcapp")

_NOTE = POINTS_NOTE[-1]
_STEPS = ("arranged", "distinct", "estimated", "oriented", "cleaned")
# What a job needs once its points are there: half of what it imports.
_LATER = (
    "hpcapp.applications.surface.input.clean_regions",
    "hpcapp.applications.surface.job.steps",
    "hpcapp.applications.surface.hierarchical.method",
)


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """A cloud, and what was left out of it.

    Parameters
    ----------
    cloud : ArrangedCloud
    dropped : Dropped
    cleaned : Cleaned
    findings : Findings
        What is odd about the file.
    columns : PointCloud
        Without points: colours and attributes that are to be carried to the mesh.
    labels : frozenset of str
        Attributes of a cloud in memory of which no mean is to be taken.
    oriented : Oriented
        How its normals came about.
    """

    cloud: ArrangedCloud
    dropped: Dropped
    cleaned: Cleaned
    findings: Findings = field(default_factory=Findings)
    columns: PointCloud = field(default_factory=lambda: PointCloud(np.empty((0, 3))))
    labels: frozenset[str] = frozenset()
    oriented: Oriented = FROM_FILE

    def report(self, shown: str) -> None:
        """Log what was left out of the input.

        Parameters
        ----------
        shown : str
            The input, for the messages.
        """
        for line in self.findings.lines():
            log.warning("warning: %s: %s", shown, line)
        dropped, cleaned = self.dropped, self.cleaned
        for count, what in (
            (dropped.non_finite_points, "dropped %d points that are NaN or Inf"),
            (dropped.bad_normals, "dropped %d points whose normal is zero, NaN or Inf"),
            (cleaned.repeated, "dropped %d points at the place of another"),
            (cleaned.outliers, "dropped %d outliers"),
            (cleaned.flipped, "flipped %d inconsistent normals"),
        ):
            if count:
                log.warning(f"%s: {what}", shown, count)
        self.oriented.report(shown)


def load_memory(settings: JobSettings, clock: StageClock) -> Loaded:
    """Read a file and clean its points.

    Parameters
    ----------
    settings : JobSettings
    clock : StageClock

    Returns
    -------
    Loaded
    """
    name = str(settings.points)
    with clock.stage("read"):
        source = _open_source(settings)
        read = settings.attributes.select(read_whole(source), settings.shown)
        labels = find_labels(read.attributes)
        points, dropped = drop_unusable(read, name)
        del read
    cloud, cleaned = arrange_usable(settings, points, clock)
    del points  # makes room
    refuse_too_few(len(cloud), dropped, name)
    scanners = _find_scanners(settings, source)
    cloud, oriented = orient_points(settings, cloud, scanners, clock, source.oriented)
    cloud, cleaned = clean_points(settings, cloud, cleaned, clock)
    columns = cloud.points.view(slice(0))
    return Loaded(cloud, dropped, cleaned, source.findings, columns, labels, oriented)


def _open_source(settings: JobSettings) -> PointSource:
    """Open the file, without its normals where they are not wanted."""
    source = open_points(settings.points)
    return source.without_normals() if settings.normals == "estimate" else source


def _find_scanners(settings: JobSettings, source: PointSource) -> FloatArray | None:
    """Return where scanners stood, in the file's coordinates; None where nobody knows."""
    if settings.viewpoints:
        return np.array(settings.viewpoints)
    known = [scan.scanner for scan in source.scans if scan.scanner is not None]
    return np.array(known) if len(known) == len(source.scans) else None


def orient_points(
    settings: Settings,
    cloud: MemoryCloud,
    scanners: FloatArray | None,
    clock: StageClock,
    is_oriented: bool = True,
) -> tuple[MemoryCloud, Oriented]:
    """Give points normals where they have none, or such that contradict each other.

    Parameters
    ----------
    settings : Settings
    cloud : MemoryCloud
    scanners : ndarray of float64, shape (s, 3), or None
        Where scanners stood, in the file's coordinates.
    clock : StageClock
    is_oriented : bool
        Whether the file says that its normals have a side.

    Returns
    -------
    cloud : MemoryCloud
    oriented : Oriented
    """
    points = cloud.points
    if points.normals is not None and (
        settings.normals == "file" or (is_oriented and not is_contradicting(points))
    ):
        return cloud, FROM_FILE
    from hpcapp.applications.surface.input.normals import orient_cloud  # scipy takes its time

    with clock.stage("normals"):
        local = None if scanners is None else scanners - cloud.origin
        turned, oriented = orient_cloud(points, local, settings.attributes.has_confidence)
    return replace(cloud, points=turned), oriented


def arrange_usable(
    settings: Settings, points: PointCloud, clock: StageClock
) -> tuple[MemoryCloud, Cleaned]:
    """Drop points that lie far away, arrange the rest, and drop those at the place of another.

    Parameters
    ----------
    settings : Settings
        The method tells whether far points are dropped, and whether the others are arranged.
    points : PointCloud
        Usable ones.
    clock : StageClock

    Returns
    -------
    cloud : MemoryCloud
        Of a copy, where they are arranged: the caller may let go of its own.
    cleaned : Cleaned
        What was dropped.
    """
    if settings.method.needs_whole_cloud:  # it cuts the cloud up by itself
        cloud = drop_repeated(MemoryCloud.as_they_are(points))
        return cloud, Cleaned(0, 0, len(points) - len(cloud))
    with clock.stage("arrange"):
        near = drop_far(points) if settings.method.cleans else points
        cloud = drop_repeated(arrange_cloud(near))
    return cloud, Cleaned(len(points) - len(near), 0, len(near) - len(cloud))


def clean_points(
    settings: Settings, cloud: MemoryCloud, before: Cleaned, clock: StageClock
) -> tuple[MemoryCloud, Cleaned]:
    """Drop outliers and flip inconsistent normals, where that is wanted.

    Parameters
    ----------
    settings : Settings
    cloud : MemoryCloud
    before : Cleaned
        What was dropped already.
    clock : StageClock

    Returns
    -------
    cloud : MemoryCloud
    cleaned : Cleaned
        All that was done.
    """
    if not settings.method.cleans:
        return cloud, before
    with clock.stage("clean"):
        cloud, cleaned = clean_cloud(cloud)
    return cloud, replace(
        before, outliers=before.outliers + cleaned.outliers, flipped=cleaned.flipped
    )


def load_folder(settings: JobSettings, folder: Path, passes: Passes, clock: StageClock) -> Loaded:
    """Put a file's points into a folder, and clean them there.

    Parameters
    ----------
    settings : JobSettings
        With `resume`, what is in the folder is taken, if it is whole.
    folder : Path
        Is made where there is none; 24 bytes a point are written, and those of regions that change
        again.
    passes : Passes
        Who goes through the points; so many may be in memory at once, here and on each worker.
    clock : StageClock

    Returns
    -------
    Loaded
        The same points as `load_memory` gives, bit for bit; measured.
    """
    source = open_points(settings.points)
    columns = _find_columns(settings, source)
    if settings.resume and (found := _find_loaded(folder)) is not None:
        return replace(found, columns=columns)
    remove_path(folder)
    run = secrets.token_hex(4)  # a worker that is late must not write into a later run's points
    folders = {name: folder / f"{name}-{run}" for name in _STEPS}
    make_private_folder(folders["arranged"])
    make_private_folder(folders["distinct"])
    for module in _LATER:
        passes.workforce.defer(partial(import_module, module))
    source = _open_source(settings)
    with clock.stage("read"):
        read = ingest_file(source, folders["arranged"], passes, drop_far=settings.method.cleans)
    from hpcapp.applications.surface.input.clean_regions import (
        clean_regions,
        drop_repeated_there,
        measure_cloud,
    )

    with clock.stage("arrange"):
        cloud, repeated = drop_repeated_there(read.cloud, folders["distinct"], passes)
    refuse_too_few(len(cloud), read.dropped, str(settings.points))
    boxes = None if repeated else read.boxes  # which count all points
    spacing = measure_spacing(cloud, passes, (len(cloud), cloud.low, cloud.high), None, boxes)
    cloud, oriented = _orient_there(settings, source, cloud, folders, passes, spacing, clock)
    _take_away(folders, cloud)
    cleaned = Cleaned(0, 0)
    if settings.method.cleans:
        make_private_folder(folders["cleaned"])
        with clock.stage("clean"):
            cloud, cleaned = clean_regions(cloud, folders["cleaned"], passes, boxes)
    else:
        cloud = measure_cloud(cloud, passes, spacing)
    _take_away(folders, cloud)
    cleaned = Cleaned(read.far + cleaned.outliers, cleaned.flipped, repeated)
    loaded = Loaded(cloud, read.dropped, cleaned, source.findings, columns, oriented=oriented)
    told = {
        "cloud": cloud.folder.name,
        "dropped": asdict(loaded.dropped),
        "cleaned": asdict(loaded.cleaned),
        "findings": asdict(loaded.findings),
        "oriented": asdict(loaded.oriented),
    }
    FolderStore(folder).put(_NOTE, told)
    return loaded


def _find_columns(settings: JobSettings, source: PointSource) -> PointCloud:
    """Return no points, with the columns of a file that are to be carried to the mesh."""
    first = next(source.chunks(1))
    return settings.attributes.select(first, settings.shown).view(slice(0))


def _orient_there(
    settings: JobSettings,
    source: PointSource,
    cloud: DiskCloud,
    folders: dict[str, Path],
    passes: Passes,
    spacing: float,
    clock: StageClock,
) -> tuple[DiskCloud, Oriented]:
    """Do to a cloud in a folder what `orient_points` does to one in memory."""
    if source.has_normals and (
        settings.normals == "file"
        or (source.oriented and not is_contradicting_there(cloud, passes, spacing))
    ):
        return cloud, FROM_FILE
    from hpcapp.applications.surface.input.normals import orient_regions

    with clock.stage("normals"):
        scanners = _find_scanners(settings, source)
        local = None if scanners is None else scanners - cloud.origin
        places = folders["estimated"], folders["oriented"]
        for place in places:
            make_private_folder(place)
        return orient_regions(cloud, source.has_normals, places, passes, spacing, local)


def _take_away(folders: dict[str, Path], cloud: DiskCloud) -> None:
    """Remove the folders of steps that are done, but for those that a cloud lies in."""
    for place in folders.values():
        if place != cloud.folder and not cloud.uses(place):
            shutil.rmtree(place, ignore_errors=True)  # one may write there still


def _find_loaded(folder: Path) -> Loaded | None:
    """Return the points that another run has put into a folder; None if they are not whole."""
    try:
        os.lstat(folder / _NOTE)
    except FileNotFoundError:  # it did not come so far
        return None
    except OSError as error:
        log.warning("warning: %s: %s: the points are read again", folder, error.strerror)
        return None
    try:
        told = FolderStore(folder).get(_NOTE)
        cloud = open_disk_cloud(folder / told["cloud"])
        cloud.check()
    except (JobError, DamagedError) as error:
        problem = error.problem if isinstance(error, JobError) else str(error)
        log.warning("warning: %s: the points are read again", problem)
        return None
    return Loaded(
        cloud,
        Dropped(**told["dropped"]),
        Cleaned(**told["cleaned"]),
        Findings(**told["findings"]),
        oriented=Oriented(**told["oriented"]),
    )
