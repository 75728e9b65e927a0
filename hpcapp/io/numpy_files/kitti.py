"""Sweeps of a lidar on a car, as KITTI has them: four single-precision numbers a point.

https://www.cvlibs.net/datasets/kitti/
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcapp.geometry.point_records import Column
from hpcapp.io.points.column_roles import AXES
from hpcapp.io.points.named_columns import describe_records, plan_columns
from hpcapp.io.points.point_source import PointSource, Scan
from hpccomponent.errors import InputError

_COLUMNS = (*AXES, "intensity")
_ROW = 16  # bytes
_LOOKED_AT = 1 << 16  # rows
_FARTHEST = 1e4
"""Metres from the lidar. They see some 200; of bytes that are no such numbers, one number in three
is larger, or nearer to zero than one can be measured."""
_NEAREST = 1e-6
_ADVICE = "give x, y, z and intensity, float32 each; or export the points as .ply, .las or .npy"


def open_kitti(path: Path) -> PointSource:
    """Open a file of x, y, z and intensity, which says nothing of itself.

    Raise InputError where it holds no such numbers.
    """
    size = path.stat().st_size
    if not size or size % _ROW:
        raise InputError(f"{path}: {size} bytes are no points of {_ROW}", _ADVICE)
    count = size // _ROW
    rows = np.memmap(path, "<f4", "r", shape=(count, len(_COLUMNS)))
    _check(path, rows[:: -(-count // _LOOKED_AT)])
    columns: dict[str, Column] = {name: (4 * at, "<f4") for at, name in enumerate(_COLUMNS)}
    plan = plan_columns(_COLUMNS, f"{path}: the file")
    records = describe_records(path, 0, _ROW, count, columns, plan)
    return PointSource(
        path, count, False, False, records.scan, records, lambda: None, "KITTI", _COLUMNS,
        (Scan(count),),
    )  # fmt: skip


def _check(path: Path, rows: np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> None:
    """Refuse what is no measurement."""
    sizes = np.abs(rows)
    is_odd = ~((sizes < _FARTHEST) & ((sizes > _NEAREST) | (sizes == 0.0))).all(axis=1)
    is_odd |= rows[:, 3] < 0.0
    if is_odd.mean() > 0.01:
        problem = f"{100.0 * is_odd.mean():.0f} % of its rows are no x, y, z and intensity"
        raise InputError(f"{path}: {problem}", _ADVICE)
