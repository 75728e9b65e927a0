"""Points as they are given, in files or arrays, each place once: in memory, or in a folder."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import nullcontext
from dataclasses import replace

import numpy as np

from hpcapp.applications.surface.attributes.labels import find_labels
from hpcapp.applications.surface.cleaning.drive import Cleaned, drop_repeated
from hpcapp.applications.surface.cloud.arranged import MemoryCloud, arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.cloud.folder.folder_pass import FolderPass, make_cloud_folder
from hpcapp.applications.surface.cloud.frame import Frame, shift_points
from hpcapp.applications.surface.job.columns import CarriedColumns
from hpcapp.applications.surface.job.scan import PointFolder, Scan
from hpcapp.applications.surface.job.settings import JobSettings, Settings, count_own_threads
from hpcapp.applications.surface.normals.sensor import Sensor, find_path, sensor_of
from hpcapp.applications.surface.reading.depth_steps import smooth_cloud, smooth_source
from hpcapp.applications.surface.reading.drive import ingest_file
from hpcapp.applications.surface.reading.reach import drop_far
from hpcapp.applications.surface.reading.registration import check_registration
from hpcapp.applications.surface.reading.seen_through import drop_seen_through
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.geometry.validity import Dropped
from hpcapp.io import PointSource, drop_unusable, read_whole
from hpcapp.io.points.point_source import SCAN
from hpcapp.io.points.usable import refuse_too_few
from hpcapp.progress import StageClock
from hpccomponent.files.private_files import remove_path


def read_file(
    settings: JobSettings,
    source: PointSource,
    folder: PointFolder | None,
    frame: Frame,
    clock: StageClock,
) -> Scan:
    """Read the points of a file, each place once: into a folder, or without one into memory.

    They are the same, bit for bit. The `frame` chooses their origin and their blocks.
    """
    if settings.normals == "estimate":
        source = source.without_normals()
    if settings.method.cleans:
        with clock.stage("read"):
            source = drop_seen_through(source, _find_path(settings, source))
    if folder is None:
        scan = _read_into_memory(settings, source, frame, clock)
    else:
        scan = _read_into_folder(settings, source, folder, frame, clock)
    refuse_too_few(len(scan.cloud_pass.cloud), scan.dropped, str(settings.points))
    return scan


def _read_into_memory(
    settings: JobSettings, source: PointSource, frame: Frame, clock: StageClock
) -> Scan:
    with clock.stage("read"):
        whole = read_whole(source)
        _check_scans([whole], source)
        columns = settings.attributes.select(whole, settings.shown)
        del whole
        labels = find_labels(columns.attributes)
        points, dropped = drop_unusable(columns, str(settings.points))
        del columns
        points = shift_points(points, frame.place(points.origin))
    scan = arrange_points(settings, points, labels, frame, clock)
    return replace(
        scan,
        dropped=dropped,
        is_oriented=source.oriented,
        sensor=_find_sensor(settings, source),
        is_upright=source.is_upright,
        crs=source.frame,
        findings=source.findings,
    )


def arrange_points(
    settings: Settings,
    points: PointCloud,
    labels: frozenset[str],
    frame: Frame,
    clock: StageClock,
) -> Scan:
    """Smooth the steps of depths, drop far points, arrange the rest, and drop those that repeat.

    Points are usable; the method tells whether they are cleaned, and whether they are arranged. Of
    the attributes in `labels` no mean is to be taken.
    """
    method, smoothed = settings.method, 0
    if method.cleans:
        points, smoothed = smooth_cloud(points)
    near = points
    with nullcontext() if method.needs_whole_cloud else clock.stage("arrange"):
        if method.needs_whole_cloud:  # it cuts the cloud up by itself
            cloud = MemoryCloud.as_they_are(points)
        else:
            near = drop_far(points) if method.cleans else points
            cloud = arrange_cloud(near, frame.arrange)
        whole = MemoryPass(cloud, count_own_threads(settings, len(points)))
        cloud_pass, repeated = drop_repeated(whole)
    cleaned = Cleaned(len(points) - len(near), repeated=repeated, smoothed=smoothed)
    layout = points.take(np.empty(0, np.int64))  # a view would hold the points
    columns = CarriedColumns(layout, labels)
    return Scan(cloud_pass, Dropped(0, 0), cleaned, columns, points.normals is not None)


def _read_into_folder(
    settings: JobSettings,
    source: PointSource,
    folder: PointFolder,
    frame: Frame,
    clock: StageClock,
) -> Scan:
    remove_path(folder.path)
    place, smoothed = make_cloud_folder(folder.path), 0
    with clock.stage("read"):
        if settings.method.cleans:
            source, smoothed = smooth_source(source)
        _check_scans(source.chunks(folder.workers.points), source)
        ingested = ingest_file(
            source, place, folder.workers, frame, drop_far=settings.method.cleans
        )
    with clock.stage("arrange"):
        cloud_pass = FolderPass(ingested.cloud, folder.path, folder.workers)
        cloud_pass, repeated = drop_repeated(cloud_pass)
    return Scan(
        cloud_pass,
        ingested.dropped,
        Cleaned(ingested.far, repeated=repeated, smoothed=smoothed),
        CarriedColumns.of_file(settings, source),
        source.has_normals,
        source.oriented,
        _find_sensor(settings, source),
        source.is_upright,
        source.frame,
        source.findings,
    )


def _check_scans(chunks: Iterable[PointCloud], source: PointSource) -> None:
    """Find out whether the scans of a file fit together, where it tells them apart."""
    if len(source.scans) > 1 or SCAN in source.columns:
        warning = check_registration(chunks, source.scans)
        if warning is not None:
            source.findings.warn(warning)


def _find_path(settings: JobSettings, source: PointSource) -> FloatArray:
    """Return where the sensor was, and when, (n, 4), as the user says."""
    return find_path(settings.viewpoint) * [1.0, 1.0, source.frame.height_scale, 1.0]


def _find_sensor(settings: JobSettings, source: PointSource) -> Sensor:
    """Return where the points were measured from: as the user says, else as the file does."""
    said = sensor_of(settings.viewpoint, source.upright)
    if said.is_told:
        return said.scale_heights(source.frame.height_scale)
    known = [scan.scanner for scan in source.scans if scan.scanner is not None]
    if known and len(known) == len(source.scans):
        return replace(said, kind="places", places=np.array(known))
    return replace(said, kind="above" if source.is_flown else "unknown")
