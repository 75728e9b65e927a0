"""The points of a job's input that it takes."""

from __future__ import annotations

from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.io import PointSource, open_points

MARGIN = 0.2
"""How far around a region points are taken, in its longest sides: ``benchmarks/crop_margin.py``."""


def open_source(settings: JobSettings) -> PointSource:
    """Open the points that are asked for, and those around them; z in the unit of x and y."""
    return take_asked(settings, open_whole(settings))


def open_whole(settings: JobSettings) -> PointSource:
    """Open all points as they are in the file."""
    return open_points(settings.points, keeps_noise=settings.crop.keeps_noise)


def take_asked(settings: JobSettings, whole: PointSource) -> PointSource:
    """Leave out what is not asked for; see `open_source`."""
    return settings.crop.take(whole, MARGIN).isotropic()
