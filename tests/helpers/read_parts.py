"""Points of a source, read in parts and joined."""

from __future__ import annotations

from hpcapp.geometry.points import PointCloud
from hpcapp.io.batches import join_points
from hpcapp.io.points.point_source import PointSource


def read_parts(source: PointSource, rows: int = 1 << 20) -> PointCloud:
    """Return all points; all parts have the same columns, and all but the last so many rows."""
    parts = list(source.chunks(rows))
    assert all(len(part) == rows for part in parts[:-1])
    columns = [(part.normals is None, part.colours is None, *part.attributes) for part in parts]
    assert len(set(columns)) == 1
    return join_points(parts)
