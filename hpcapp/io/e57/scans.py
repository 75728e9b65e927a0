"""What an E57 file says of its scans: poses, fields, grids."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from hpcapp.geometry.axes import turn_by
from hpcapp.geometry.points import FloatArray
from hpcapp.io.e57.document import XmlElement, refuse
from hpcapp.io.e57.packets import hold_more
from hpcapp.io.frame import check_coordinates
from hpcapp.io.points.column_roles import COLOURS, find_role
from hpccomponent.dataclass import dataclass
from hpccomponent.decoding.process import Decoder, open_decoder
from hpccomponent.errors import InputError

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
_NUMBERS = ("Float", "Integer", "ScaledInteger")  # types of a field
_SPARSEST = 100  # cells of a grid for each point, above which it is none
_ROWS_AT_ONCE = 1 << 16


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
    rotation, translation : ndarray of float64, shape (3, 3) and (3,)
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
    def fields(self) -> list[str]:
        """What is read of its points."""
        invalid = [] if self.invalid is None else [self.invalid]
        return [*self.position, *self.columns.values(), *invalid]

    @property
    def is_posed(self) -> bool:
        """Whether its pose is another than none."""
        return bool(self.translation.any() or (self.rotation != np.eye(3)).any())

    @property
    def is_ranged(self) -> bool:
        """Whether its points are surely as a scanner has seen them."""
        return self.grid is not None or self.position is SPHERICAL

    def has(self, names: tuple[str, ...]) -> bool:
        """Tell whether it has all of some columns."""
        return all(name in self.columns for name in names)


def describe_scan(node: XmlElement, index: int, path: Path) -> E57Scan:
    """Find out what a scan holds, its grid set aside.

    Raise InputError where it has no coordinates, or the file has no room for its points.
    """
    points, prototype = node.find("points"), node.find("points", "prototype")
    if points is None or prototype is None:
        raise refuse(path, f"scan {index} says nothing of its points")
    fields = {
        child.name: child
        for child in prototype.children
        if child.attributes.get("type") in _NUMBERS
    }
    position = next((names for names in (CARTESIAN, SPHERICAL) if set(names) <= set(fields)), None)
    if position is None:
        raise InputError(
            f"{path}: scan {index} has no coordinates: {', '.join(fields)}",
            "export the file with cartesian or spherical coordinates",
        )
    invalid = _INVALID[position is SPHERICAL]
    columns = _name_columns(fields)
    translation = _read_pose(node, "translation", "xyz")
    check_coordinates(translation, path, f"the pose of scan {index}")
    return E57Scan(
        index,
        _count_points(points, fields, index, path),
        position,
        invalid if invalid in fields else None,
        columns,
        _find_colour_limit(node, fields, columns),
        _find_rotation(node),
        translation,
    )


def _count_points(points: XmlElement, fields: dict[str, XmlElement], index: int, path: Path) -> int:
    """Return how many points a scan declares; the file must have room for them."""
    count = int(points.attributes.get("recordCount", 0))
    bits = max(1, sum(_count_bits(field) for field in fields.values()))
    size = path.stat().st_size
    if not 0 <= count * bits <= 8 * size:
        raise refuse(
            path,
            f"scan {index} declares {count} points of {bits} bits, more than the file's {size} "
            "bytes hold",
        )
    return count


def holds_more(node: XmlElement, points: int, path: Path) -> bool:
    """Tell whether a scan surely holds more points than the XML declares."""
    vector, prototype = node.find("points"), node.find("points", "prototype")
    if vector is None or prototype is None or not points:
        return False
    bits = [
        _count_bits(field) if field.attributes.get("type") in _NUMBERS else 0
        for field in prototype.children
    ]
    return hold_more(path, int(vector.attributes.get("fileOffset", 0)), bits, points)


def _count_bits(field: XmlElement) -> int:
    """Return the bits that a value of a field takes in the file."""
    named = field.attributes
    if named["type"] == "Float":
        return 32 if named.get("precision") == "single" else 64
    least, most = int(named.get("minimum", -(1 << 63))), int(named.get("maximum", (1 << 63) - 1))
    return max(most - least, 0).bit_length()


@contextmanager
def open_fields(path: Path, scans: Sequence[E57Scan], rows: int) -> Iterator[Decoder]:
    """Start what decodes the fields of scans, for `read_fields`: so many rows at once at most."""
    size = max(
        (len(scan.fields) * min(rows, scan.points) * np.float64().nbytes for scan in scans),
        default=0,
    )
    with open_decoder("e57", path, size, (), partial(refuse, path)) as decoder:
        yield decoder


def read_fields(
    decoder: Decoder, scan: E57Scan, names: Sequence[str], rows: int, path: Path
) -> Iterator[dict[str, FloatArray]]:
    """Yield fields of a scan's points, by their names, so many points at a time.

    The arrays (n,) are used again for the next part. Raise InputError where the file is damaged, or
    has not as many points as it declares.
    """
    rows = min(rows, scan.points)
    if not rows:
        return
    decoder.ask("open", scan.index, rows, *names)
    whole = decoder.memory[: len(names) * rows * np.float64().nbytes].view(np.float64)
    columns = dict(zip(names, whole.reshape(len(names), rows), strict=True))
    read = 0
    while count := min(decoder.ask("next"), rows):
        read += count
        yield {name: column[:count] for name, column in columns.items()}
    if read != scan.points:
        raise InputError(
            f"{path}: scan {scan.index} ends after {read} of {scan.points} points",
            "the file is damaged: copy or export it again",
        )


def bound_grids(scans: Sequence[E57Scan], path: Path) -> list[E57Scan]:
    """Find the grids of scans that have rows and columns; leave out those that make no grid.

    Errors are those of `read_fields`.
    """
    if not any(scan.points and scan.has(GRID) for scan in scans):
        return [replace(scan, columns=_without_grid(scan)) for scan in scans]
    with open_fields(path, scans, _ROWS_AT_ONCE) as decoder:
        return [_bound_grid(decoder, scan, path) for scan in scans]


def _bound_grid(decoder: Decoder, scan: E57Scan, path: Path) -> E57Scan:
    """Find the rows and columns that points have: what the header says of them is often wrong."""
    if scan.points and scan.has(GRID):
        names = [scan.columns[name] for name in GRID]
        low, high = np.full(2, np.inf), np.full(2, -np.inf)
        for part in read_fields(decoder, scan, names, _ROWS_AT_ONCE, path):
            low = np.minimum(low, [part[name].min() for name in names])
            high = np.maximum(high, [part[name].max() for name in names])
        height, width = high - low + 1
        if min(height, width) >= 2 and height * width <= _SPARSEST * scan.points:
            corner, grid = (int(low[0]), int(low[1])), (int(width), int(height))
            return replace(scan, corner=corner, grid=grid)
    return replace(scan, columns=_without_grid(scan))


def _without_grid(scan: E57Scan) -> dict[str, str]:
    return {name: field for name, field in scan.columns.items() if name not in GRID}


def _name_columns(fields: Iterable[str]) -> dict[str, str]:
    """Return the fields beside the coordinates, by the names of our columns."""
    columns: dict[str, str] = {}
    for name in fields:
        if name not in (*CARTESIAN, *SPHERICAL, *_INVALID):
            local = name.rpartition(":")[2]
            columns.setdefault(_ROLES.get(local) or find_role(local), name)
    return columns


def _read_pose(node: XmlElement, part: str, names: str) -> FloatArray:
    return np.array([node.number("pose", part, name) or 0.0 for name in names])


def _find_rotation(node: XmlElement) -> FloatArray:
    """Return the rotation of a pose, given as a quaternion, as a matrix."""
    quaternion = _read_pose(node, "rotation", "wxyz")
    length = np.linalg.norm(quaternion)
    return turn_by(quaternion / length) if 0 < length < np.inf else np.eye(3)


def _find_colour_limit(
    node: XmlElement, fields: dict[str, XmlElement], columns: dict[str, str]
) -> float | None:
    """Return the largest value that a colour can have, as stated, or as its field can hold."""
    limits: list[float] = []
    for name in COLOURS:
        if name not in columns:
            return None
        stated = node.number("colorLimits", f"color{name.capitalize()}Maximum")
        field = fields[columns[name]]
        maximum = float(field.attributes.get("maximum", np.inf))
        if field.attributes["type"] == "ScaledInteger":
            maximum = field.scale(maximum)
        limits.append(maximum if stated is None else stated)
    largest = max(limits)
    return largest if 0 < largest <= 65535 else None
