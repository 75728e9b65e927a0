"""The points of a job's input that it takes, and what the input was taken for."""

from __future__ import annotations

from typing import Any

from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.io import PointSource, open_points
from hpcapp.io.points.column_roles import tell_use

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


def describe_input(settings: JobSettings, source: PointSource) -> dict[str, Any]:
    """Return what the input is, and what its columns were taken for.

    The source has its points as they are in the file. JSON values: ``files`` as the user named
    them, ``format``, ``columns`` (what each was taken for, by its name), ``crs``, ``unit`` and
    ``height_unit`` where the file tells, ``up`` (which way that is, and why).
    """
    first = next(source.chunks(1))
    return {
        "files": [str(file) for file in settings.files],
        "format": source.format,
        "columns": {name: tell_use(name, first) for name in source.columns},
        "crs": source.crs,
        "unit": source.unit,
        "height_unit": source.height_unit,
        "up": source.up,
    }
