"""The path of a sensor, as lines of numbers: x, y, z, the time before them, or poses of KITTI."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcapp.geometry.paths import MOST_PLACES, MOST_TIMED, thin_path
from hpcapp.geometry.points import FloatArray
from hpcapp.io.cameras.poses import are_rotations
from hpcapp.io.points.column_roles import AXES, find_role, is_time
from hpcapp.io.points.point_source import Findings, translated
from hpcapp.io.text.layout import find_layout
from hpcapp.io.text.lines import LineReader, read_blocks
from hpcapp.io.text.tables import RowNotes, parse_block
from hpccomponent.errors import InputError
from hpccomponent.ranges import FARTHEST

_POSE = 12  # numbers of three rows of a rotation and a place


def read_trajectory(path: Path) -> FloatArray:
    """Read where a sensor came along, and when: places (n, 3), or (n, 4) with the time last.

    They lie at even distances along the path, 64 at most, and 1,024 with times. Columns are told by
    their names. Without names they are x, y, z where there are three; twelve that are a rotation
    and a place, row by row, are poses of KITTI; else the time comes first. Separators are those of
    point clouds. Raise InputError where the file has no such rows.
    """
    with translated(path):
        layout, sample = find_layout(path, Findings())
        lines = LineReader(read_blocks(path, layout.encoding))
        for _ in lines.take(layout.first_row - 1):
            pass
        columns, notes = _find_columns(layout.names, layout.rows.wanted, sample), RowNotes(path)
        rest = path.stat().st_size
        tables = [parse_block(block, layout.rows, notes)[:, columns] for block in lines.take(rest)]
    places = np.concatenate([np.empty((0, len(columns))), *tables])
    is_finite = np.isfinite(places)
    beyond = np.flatnonzero((is_finite & (np.abs(places) > FARTHEST))[:, :3].any(axis=1))
    if len(beyond):
        row = int(beyond[0])
        raise InputError(
            f"{path}: row {row + 1} of the trajectory is no place: {places[row, :3].tolist()}",
            f"coordinates are numbers up to {FARTHEST:.0e}: correct or remove it",
        )
    places = places[is_finite.all(axis=1)]
    if not len(places):
        raise InputError(f"{path}: is no trajectory: no line has x, y and z", "check the file")
    if len(columns) == 3:
        return thin_path(places, MOST_PLACES)
    order = np.argsort(places[:, 3], kind="stable")
    return thin_path(places.take(order, axis=0), MOST_TIMED)


def _find_columns(
    names: tuple[str, ...] | None, wanted: tuple[int, ...], sample: FloatArray
) -> list[int]:
    """Return which of the columns that are read are x, y, z and, where there is one, the time."""
    if names is None:
        if len(wanted) == _POSE and are_rotations(sample.reshape(-1, 3, 4)[:, :, :3]).all():
            return [3, 7, 11]
        return [0, 1, 2] if len(wanted) == 3 else [1, 2, 3, 0]
    roles = [find_role(names[i]) for i in wanted]
    times = [k for k, i in enumerate(wanted) if is_time(names[i])]
    return [*(roles.index(axis) for axis in AXES), *times[:1]]
