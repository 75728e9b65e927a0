"""What an E57 file says of its scans: poses, fields, grids."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hpcapp.io.e57.image_file import find_number, numeric_fields
from hpcapp.io.points.column_roles import COLOURS, find_role
from hpccomponent.errors import InputError
from hpccomponent.surface.types.points import FloatArray

__all__ = ["CARTESIAN", "GRID", "SPHERICAL", "E57Scan", "describe_scan", "read_fields"]

CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
GRID = ("row", "column")
_ROLES = {
    "colorRed": "red",
    "colorGreen": "green",
    "colorBlue": "blue",
    "rowIndex": "row",
    "columnIndex": "column",
    "returnIndex": "return_number",
    "returnCount": "number_of_returns",
    "timeStamp": "time",
    "pointSourceId": "point_source_id",
}
_INVALID = ("cartesianInvalidState", "sphericalInvalidState")
_SPARSEST = 100  # cells of a grid for each point, above which it is none
_ROWS_AT_ONCE = 1 << 18


@dataclass(frozen=True, slots=True, eq=False)
class E57Scan:
    """A scan of an E57 file.

    Parameters
    ----------
    index : int
        Its number, from 0.
    points : int
        How many it has, invalid ones too.
    position : tuple of str
        The fields of the coordinates: `CARTESIAN` or `SPHERICAL`.
    invalid : str or None
        The field that tells whether they are valid.
    columns : dict of str to str
        Its other fields, by the names of our columns.
    colour_limit : float or None
        What white is; None where that is not stated.
    rotation : ndarray of float64, shape (3, 3)
    translation : ndarray of float64, shape (3,)
        The pose: a point of the file is rotated and then moved. The scanner stood at
        `translation`.
    corner : tuple of int
        Least row and column.
    grid : tuple of int or None
        Width and height, where it is organised.
    """

    index: int
    points: int
    position: tuple[str, ...]
    invalid: str | None
    columns: dict[str, str]
    colour_limit: float | None
    rotation: FloatArray
    translation: FloatArray
    corner: tuple[int, int] = (0, 0)
    grid: tuple[int, int] | None = None

    @property
    def is_posed(self) -> bool:
        """Whether its pose is another than none."""
        return bool(self.translation.any() or (self.rotation != np.eye(3)).any())

    @property
    def is_ranged(self) -> bool:
        """Whether its points are surely as a scanner has seen them."""
        return self.grid is not None or self.position is SPHERICAL

    def has(self, names: tuple[str, ...]) -> bool:
        """Tell whether it has all of some columns.

        Parameters
        ----------
        names : tuple of str

        Returns
        -------
        bool
        """
        return all(name in self.columns for name in names)


def describe_scan(library: Any, image: Any, index: int, path: Path) -> E57Scan:
    """Find out what a scan holds.

    Parameters
    ----------
    library : module
        ``pye57.libe57``.
    image : libe57.ImageFile
    index : int
        Number of the scan, from 0.
    path : Path
        The file, for messages.

    Returns
    -------
    E57Scan

    Raises
    ------
    InputError
        It has no coordinates.
    """
    node = image.root()["data3D"][index]
    fields = numeric_fields(library, node["points"])
    position = next((names for names in (CARTESIAN, SPHERICAL) if set(names) <= set(fields)), None)
    if position is None:
        raise InputError(
            f"{path}: scan {index} has no coordinates: {', '.join(fields)}",
            "export the file with cartesian or spherical coordinates",
        )
    invalid = _INVALID[position is SPHERICAL]
    columns: dict[str, str] = {}
    for name in fields:
        if name not in (*CARTESIAN, *SPHERICAL, *_INVALID):
            local = name.rpartition(":")[2]
            columns.setdefault(_ROLES.get(local) or find_role(local), name)
    corner, grid = (0, 0), None
    points = int(node["points"].childCount())
    if points and set(GRID) <= set(columns):
        corner, grid = _bound_grid(library, image, index, [columns[name] for name in GRID], points)
    if grid is None:
        for name in GRID:
            columns.pop(name, None)
    return E57Scan(
        index,
        points,
        position,
        invalid if invalid in fields else None,
        columns,
        _find_colour_limit(node, fields, columns),
        _find_rotation(node),
        np.array([find_number(node, "pose", "translation", axis) or 0.0 for axis in "xyz"]),
        corner,
        grid,
    )


def read_fields(
    library: Any, image: Any, index: int, names: list[str], rows: int
) -> Iterator[dict[str, FloatArray]]:
    """Yield fields of a scan's points, so many points at a time.

    Parameters
    ----------
    library : module
        ``pye57.libe57``.
    image : libe57.ImageFile
    index : int
        Number of the scan, from 0.
    names : list of str
        Of the fields.
    rows : int
        Points in a part, at most.

    Yields
    ------
    dict of str to ndarray of float64, shape (n,)
        By name; the arrays are used again for the next part.
    """
    points = image.root()["data3D"][index]["points"]
    rows = max(min(rows, points.childCount()), 1)
    arrays = {name: np.empty(rows) for name in names}
    buffers = library.VectorSourceDestBuffer()
    for name, array in arrays.items():
        buffers.append(library.SourceDestBuffer(image, name, array, rows, True, True))
    reader = points.reader(buffers)
    try:
        while count := reader.read():
            yield {name: array[:count] for name, array in arrays.items()}
    finally:
        with suppress(library.E57Exception):  # of the reading, if any: that one tells
            reader.close()


def _bound_grid(
    library: Any, image: Any, index: int, names: list[str], points: int
) -> tuple[tuple[int, int], tuple[int, int] | None]:
    """Find the rows and columns that points have: what the header says of them is often wrong."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for part in read_fields(library, image, index, names, _ROWS_AT_ONCE):
        low = np.minimum(low, [part[name].min() for name in names])
        high = np.maximum(high, [part[name].max() for name in names])
    height, width = high - low + 1
    if min(height, width) < 2 or not height * width <= _SPARSEST * points:
        return (0, 0), None
    return (int(low[0]), int(low[1])), (int(width), int(height))


def _find_rotation(node: Any) -> FloatArray:
    """Return the rotation of a pose, given as a quaternion, as a matrix."""
    numbers = [find_number(node, "pose", "rotation", part) for part in "wxyz"]
    quaternion = np.array([number or 0.0 for number in numbers])
    length = np.linalg.norm(quaternion)
    if not 0 < length < np.inf:
        return np.eye(3)
    w, x, y, z = quaternion / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _find_colour_limit(node: Any, fields: dict[str, Any], columns: dict[str, str]) -> float | None:
    """Return the largest value that a colour can have, as stated, or as its field can hold."""
    limits: list[float] = []
    for name in COLOURS:
        if name not in columns:
            return None
        stated = find_number(node, "colorLimits", f"color{name.capitalize()}Maximum")
        field = fields[columns[name]]
        maximum = float(getattr(field, "scaledMaximum", field.maximum)())
        limits.append(maximum if stated is None else stated)
    largest = max(limits)
    return largest if 0 < largest <= 65535 else None
