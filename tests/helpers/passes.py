"""Passes through clouds: in memory, or in a folder by one process or by some workers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from disk_clouds import DiskCloudWriter

from hpcapp.applications.surface.cloud.arranged import MemoryCloud, arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.cloud.folder.folder_pass import FolderPass, make_cloud_folder
from hpcapp.applications.surface.cloud.measure import measure_cloud, measure_scale
from hpcapp.applications.surface.cloud.point_workers import PointWorkers
from hpcapp.applications.surface.normals.reading import read_scan
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.backends.serial import SerialExecutor
from hpcapp.geometry.points import PointCloud
from hpcapp.workforce import Workforce


def in_memory(points: PointCloud) -> MemoryPass:
    """Return the pass through points as they are."""
    return MemoryPass(MemoryCloud.as_they_are(points))


def measure_read(points: PointCloud) -> MemoryCloud:
    """Arrange points with normals in memory, measure and read them."""
    cloud_pass = MemoryPass(arrange_cloud(points))
    scale = measure_scale(cloud_pass)
    reading = read_scan(cloud_pass, scale, Sensor(), is_upright=False)
    return measure_cloud(cloud_pass, scale, reading).cloud


def alone(points: int, *, sees: bool = True) -> PointWorkers:
    """Return this process, which takes so many points at once."""
    return PointWorkers(Workforce(SerialExecutor(), in_process=True), sees, points)


def in_folder(points: PointCloud, place: Path, workers: PointWorkers) -> FolderPass:
    """Put points into a folder, as if they had been read in five parts."""
    arranged = arrange_cloud(points)
    folder = make_cloud_folder(place)
    writer = DiskCloudWriter(folder, arranged.arrangement, points.origin)
    normals = np.zeros_like(points.positions) if points.normals is None else points.normals
    for part in np.array_split(np.arange(len(points)), 5):
        writer.add(points.positions[part], normals[part])
    return FolderPass(writer.finish(), place, workers)
