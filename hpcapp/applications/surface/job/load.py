"""A cloud from its file to what the methods take: in memory, or in a folder."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np

from hpcapp.applications.surface.attributes.choice import CONFIDENCE
from hpcapp.applications.surface.attributes.labels import find_labels
from hpcapp.applications.surface.checkpoint import POINTS_NOTE
from hpcapp.applications.surface.cleaning.drive import (
    Cleaned,
    drop_repeated,
    drop_strays,
    mend_normals,
    thin_lines,
)
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud, MemoryCloud, arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import CloudPass, MemoryPass
from hpcapp.applications.surface.cloud.disk import open_disk_cloud
from hpcapp.applications.surface.cloud.folder_pass import FolderPass, make_cloud_folder
from hpcapp.applications.surface.cloud.measure import (
    measure_cloud,
    measure_scale,
    measure_spacing,
)
from hpcapp.applications.surface.cloud.point_workers import PointWorkers
from hpcapp.applications.surface.cloud.surface_check import check_surface
from hpcapp.applications.surface.job.columns import Columns
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.applications.surface.normals.sides import Oriented, orient_cloud
from hpcapp.applications.surface.reading.drive import ingest_file
from hpcapp.applications.surface.reading.reach import drop_far
from hpcapp.applications.surface.reading.registration import check_registration
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.applications.surface.settings import JobSettings, Settings
from hpcapp.applications.surface.viewpoint import Viewpoint
from hpcapp.geometry.points import PointCloud
from hpcapp.geometry.validity import Dropped
from hpcapp.io import PointSource, drop_unusable, open_points, read_whole
from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.io.points.point_source import SCAN, Findings
from hpcapp.io.points.usable import refuse_too_few
from hpcapp.progress import StageClock
from hpccomponent.errors import JobError
from hpccomponent.files.private_files import remove_path
from hpccomponent.store.base import FolderStore
from hpccomponent.store.value import DamagedError

log = logging.getLogger("hpcapp")

_NOTE = POINTS_NOTE[-1]
# What a job needs once its points are there: half of what it imports.
_LATER = (
    "hpcapp.applications.surface.job.steps",
    "hpcapp.applications.surface.hierarchical.method",
)


@dataclass(frozen=True, slots=True, eq=False)
class PointFolder:
    """A folder that a job's points are put into, and who goes through them there.

    Parameters
    ----------
    path : Path
        Is made where there is none; 24 bytes a point are written, and those of blocks that change
        again.
    workers : PointWorkers
    """

    path: Path
    workers: PointWorkers


@dataclass(frozen=True, slots=True, eq=False)
class Read:
    """Points as they were read, each place once, and what is known of them.

    Parameters
    ----------
    cloud_pass : CloudPass
    dropped : Dropped
        Points that cannot be used.
    cleaned : Cleaned
        Points that were dropped because they lie far away or at the place of another.
    columns : Columns
        What is to be carried to the mesh.
    has_normals, is_oriented : bool
        Whether the points have normals, and whether the input says that these have a side.
    sensor : Sensor
        Where they were measured from.
    crs : Crs
        What the file's coordinates mean; heights are in the unit of x and y here.
    """

    cloud_pass: CloudPass
    dropped: Dropped
    cleaned: Cleaned
    columns: Columns
    has_normals: bool
    is_oriented: bool = True
    sensor: Sensor = field(default_factory=Sensor)
    crs: Crs = UNKNOWN


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """A cloud, and what was left out of it.

    Parameters
    ----------
    cloud : ArrangedCloud
    dropped : Dropped
    cleaned : Cleaned
    columns : Columns
        Colours and attributes that are to be carried to the mesh.
    oriented : Oriented
        How its normals came about.
    findings : Findings
        What is odd about the file.
    crs : Crs
        What the file's coordinates mean.
    """

    cloud: ArrangedCloud
    dropped: Dropped
    cleaned: Cleaned
    columns: Columns
    oriented: Oriented
    findings: Findings
    crs: Crs

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
        if cleaned.spared:
            log.info(
                "%s: scan lines some %.3g apart, with points every %.3g: %d of these spared",
                shown, cleaned.line_gap, cleaned.line_step, cleaned.spared,
            )  # fmt: skip
        for count, what in (
            (dropped.non_finite_points, "dropped %d points that are NaN or Inf"),
            (dropped.bad_normals, "dropped %d points whose normal is zero, NaN or Inf"),
            (cleaned.repeated, "dropped %d points at the place of another"),
            (cleaned.outliers, "dropped %d outliers"),
            (cleaned.strays, "dropped %d stray points near the surface"),
            (cleaned.lone_lines, "dropped %d points along lone lines: wires have no surface"),
            (cleaned.flipped, "flipped %d inconsistent normals"),
        ):
            if count:
                log.warning(f"%s: {what}", shown, count)
        self.oriented.report(shown)


def load(settings: JobSettings, clock: StageClock, folder: PointFolder | None = None) -> Loaded:
    """Read a job's points, and make of them what its method takes.

    Parameters
    ----------
    settings : JobSettings
    clock : StageClock
    folder : PointFolder, optional
        Where the points are put; into memory by default. They are the same, bit for bit. With
        `resume`, what is in the folder is taken, if it is whole.
    """
    source = open_points(settings.points).isotropic()
    if folder is not None and settings.resume:
        loaded = _find_loaded(folder.path, Columns.of_file(settings, source), source.frame)
        if loaded is not None:
            return loaded
    if settings.normals == "estimate":
        source = source.without_normals()
    if folder is None:
        read = _read_into_memory(settings, source, clock)
    else:
        read = _read_into_folder(settings, source, folder, clock)
    refuse_too_few(len(read.cloud_pass.cloud), read.dropped, str(settings.points))
    loaded = replace(prepare(settings, read, clock), findings=source.findings)
    if folder is not None:
        _note(folder.path, loaded)
    return loaded


def _read_into_memory(settings: JobSettings, source: PointSource, clock: StageClock) -> Read:
    with clock.stage("read"):
        whole = read_whole(source)
        _check_scans([whole], source)
        columns = settings.attributes.select(whole, settings.shown)
        del whole
        labels = find_labels(columns.attributes)
        points, dropped = drop_unusable(columns, str(settings.points))
        del columns
    read = arrange_points(settings, points, labels, clock)
    return replace(
        read,
        dropped=dropped,
        is_oriented=source.oriented,
        sensor=_find_sensor(settings, source),
        crs=source.frame,
    )


def arrange_points(
    settings: Settings, points: PointCloud, labels: frozenset[str], clock: StageClock
) -> Read:
    """Drop points that lie far away, arrange the rest, and drop those at the place of another.

    Parameters
    ----------
    settings : Settings
        The method tells whether far points are dropped, and whether the others are arranged.
    points : PointCloud
        Usable ones.
    labels : frozenset of str
        Attributes of which no mean is to be taken.
    clock : StageClock
    """
    method, near = settings.method, points
    with nullcontext() if method.needs_whole_cloud else clock.stage("arrange"):
        if method.needs_whole_cloud:  # it cuts the cloud up by itself
            cloud = MemoryCloud.as_they_are(points)
        else:
            near = drop_far(points) if method.cleans else points
            cloud = arrange_cloud(near)
        cloud_pass, repeated = drop_repeated(MemoryPass(cloud))
    cleaned = Cleaned(len(points) - len(near), repeated=repeated)
    columns = Columns(points.take(np.empty(0, np.int64)), labels)  # a view would hold the points
    return Read(cloud_pass, Dropped(0, 0), cleaned, columns, points.normals is not None)


def _read_into_folder(
    settings: JobSettings, source: PointSource, folder: PointFolder, clock: StageClock
) -> Read:
    remove_path(folder.path)
    for module in _LATER:
        folder.workers.workforce.defer(partial(import_module, module))
    place = make_cloud_folder(folder.path)
    with clock.stage("read"):
        _check_scans(source.chunks(folder.workers.points), source)
        ingested = ingest_file(source, place, folder.workers, drop_far=settings.method.cleans)
    with clock.stage("arrange"):
        cloud_pass = FolderPass(ingested.cloud, folder.path, folder.workers)
        cloud_pass, repeated = drop_repeated(cloud_pass)
    return Read(
        cloud_pass,
        ingested.dropped,
        Cleaned(ingested.far, repeated=repeated),
        Columns.of_file(settings, source),
        source.has_normals,
        source.oriented,
        _find_sensor(settings, source),
        source.frame,
    )


def _check_scans(chunks: Iterable[PointCloud], source: PointSource) -> None:
    """Find out whether the scans of a file fit together, where it tells them apart."""
    if len(source.scans) > 1 or SCAN in source.columns:
        warning = check_registration(chunks, source.scans)
        if warning is not None:
            source.findings.warn(warning)


def told_sensor(viewpoint: Viewpoint) -> Sensor:
    """Return what a user says of where points were measured from."""
    if isinstance(viewpoint, str):
        return Sensor(viewpoint, is_told=True)
    if not viewpoint:
        return Sensor()
    rows = np.array([(*place, 0.0, 0.0, 0.0)[:6] for place in viewpoint])
    return Sensor("places", rows[:, :3], rows[:, 3:], is_told=True)


def _find_sensor(settings: JobSettings, source: PointSource) -> Sensor:
    """Return where the points were measured from: as the user says, else as the file does."""
    told = told_sensor(settings.viewpoint)
    if told.is_told:
        return told.scale_heights(source.frame.height_scale)
    known = [scan.scanner for scan in source.scans if scan.scanner is not None]
    if known and len(known) == len(source.scans):
        return Sensor("places", np.array(known))
    return Sensor("above" if source.is_flown else "unknown")


def prepare(settings: Settings, read: Read, clock: StageClock) -> Loaded:
    """Clean points that were read, and give them their normals.

    Parameters
    ----------
    settings : Settings
    read : Read
        Ten points or more.
    clock : StageClock

    Returns
    -------
    Loaded
        Measured.

    Raises
    ------
    InputError
        Points without normals lie on no surface.
    """
    cloud_pass, method = read.cloud_pass, settings.method
    is_asked = settings.attributes.has_confidence
    keeps = is_asked and CONFIDENCE not in read.columns.layout.attributes
    cleaned = read.cleaned
    if method.cleans:
        with clock.stage("clean"):
            cloud_pass, thinned, scale = thin_lines(cloud_pass)
            _check_surface(read, cloud_pass, scale.spacing)
            cloud_pass, found, scale = drop_strays(cloud_pass, scale)
        cleaned = cleaned.plus(thinned).plus(found)
    else:
        if method.needs_whole_cloud:  # which lies in no blocks, and so in no cells
            scale = LocalScale.uniform(measure_spacing(cloud_pass))
        else:
            scale, _ = measure_scale(cloud_pass)
        _check_surface(read, cloud_pass, scale.spacing)
    cloud_pass, oriented = orient_cloud(
        cloud_pass,
        scale.spacing,
        settings.normals,
        read.sensor,
        clock,
        has_normals=read.has_normals,
        is_oriented=read.is_oriented,
        attribute=CONFIDENCE if keeps else None,
    )
    if method.cleans:
        with clock.stage("mend normals"):
            cloud_pass, flipped = mend_normals(cloud_pass, scale.spacing)
        cleaned = replace(cleaned, flipped=flipped)
    cloud = measure_cloud(cloud_pass, scale).cloud
    return Loaded(cloud, read.dropped, cleaned, read.columns, oriented, Findings(), read.crs)


def _check_surface(read: Read, cloud_pass: CloudPass, spacing: float) -> None:
    """Refuse points without normals that lie on no surface."""
    if not read.has_normals and (problem := check_surface(cloud_pass, spacing)) is not None:
        raise problem


def _note(folder: Path, loaded: Loaded) -> None:
    """Keep what is known of the points beside them, for a job that goes on from there."""
    told = {
        "cloud": Path(str(loaded.cloud.place)).name,
        "dropped": asdict(loaded.dropped),
        "cleaned": asdict(loaded.cleaned),
        "findings": asdict(loaded.findings),
        "oriented": asdict(loaded.oriented),
    }
    FolderStore(folder).put(_NOTE, told)


def _find_loaded(folder: Path, columns: Columns, crs: Crs) -> Loaded | None:
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
        columns,
        Oriented(**told["oriented"]),
        Findings(**told["findings"]),
        crs,
    )
