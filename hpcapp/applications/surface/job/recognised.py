"""What the input of a job was taken for."""

from __future__ import annotations

from typing import Any

from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.io import PointSource
from hpcapp.io.points.column_roles import tell_use


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
