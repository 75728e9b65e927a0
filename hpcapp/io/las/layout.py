"""What the bytes of a LAS point mean: the eleven point formats and the extra bytes behind them.

The fields are those of the specification, ASPRS LAS 1.4 R15, tables 7 to 17 and 24.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import BoolArray, FloatArray, PointCloud
from hpcapp.io.columns import Numbers
from hpcapp.io.las.header import LasHeader
from hpcapp.io.points.column_roles import AXES, COLOURS, NORMALS, find_role
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Bytes of a point of each format, without extra bytes."""

DEGREES_A_STEP = 0.006
"""Of the scan angle, from point format 6 on; before that it is whole degrees."""

NOISE = (7, 18)
"""Classes of points that are none: low noise, and high noise (from point format 6 on)."""

_OLD = {
    "intensity": ("<u2", 12),
    "returns": ("u1", 14),
    "classification": ("u1", 15),
    "scan_angle": ("i1", 16),
    "user_data": ("u1", 17),
    "point_source_id": ("<u2", 18),
}
_NEW = {
    "intensity": ("<u2", 12),
    "returns": ("u1", 14),
    "flags": ("u1", 15),
    "classification": ("u1", 16),
    "user_data": ("u1", 17),
    "scan_angle": ("<i2", 18),
    "point_source_id": ("<u2", 20),
}
_GPS_TIME_AT = {1: 20, 3: 20, 4: 20, 5: 20, 6: 22, 7: 22, 8: 22, 9: 22, 10: 22}
_COLOURS_AT = {2: 20, 3: 28, 5: 28, 7: 30, 8: 30, 10: 30}
_NEAR_INFRARED_AT = {8: 36, 10: 36}

_DESCRIPTION = np.dtype(
    {
        "names": ["type", "options", "name", "scale", "offset"],
        "formats": ["u1", "u1", "S32", ("<f8", 3), ("<f8", 3)],
        "offsets": [2, 3, 4, 112, 136],
        "itemsize": 192,
    }
)
_EXTRA_TYPES = ("u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f4", "<f8")
_HAS_SCALE, _HAS_OFFSET = 8, 16


Field = tuple[str | tuple[str, int] | np.dtype[np.number], int]
"""The type of a field, and its byte."""


@dataclass(frozen=True, slots=True)
class _Extra:
    """A column in the extra bytes: its name, and what its numbers are multiplied by and added."""

    name: str
    scale: float
    offset: float


@dataclass(frozen=True, slots=True, eq=False)
class LasLayout:
    """How a file's points, structured, are decoded.

    Scales and offsets (3,) are those of the coordinates; extras are columns in the extra bytes.
    """

    point_format: int
    dtype: np.dtype[np.void]
    scales: FloatArray
    offsets: FloatArray
    extras: tuple[_Extra, ...]

    @property
    def has_normals(self) -> bool:
        """Whether the extra bytes hold normals."""
        return set(NORMALS) <= {extra.name for extra in self.extras}

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of what a point has, in the order of the file."""
        names: list[str] = []
        for name in self.dtype.names or ():
            if name == "returns":
                names += ["return_number", "number_of_returns"]
            elif name == "colours":
                names += COLOURS
            elif name == "xyz":
                names += AXES
            elif name != "flags":
                names.append(name)
        return tuple(names)

    def select(self, points: NDArray[np.void]) -> tuple[BoolArray, BoolArray]:
        """Tell which points are flagged as withheld, (n,), and which others are noise by class."""
        if self.point_format < 6:
            withheld = points["classification"] & 0x80 != 0
            noise = points["classification"] & 31 == NOISE[0]
        else:
            withheld = points["flags"] & 4 != 0
            noise = np.isin(points["classification"], NOISE)
        return withheld, noise & ~withheld

    def decode(self, points: NDArray[np.void]) -> PointCloud:
        """Return points, of `dtype`, as a cloud in the file's coordinates.

        A copy; colours are of 16 bits, whatever the file makes of them.
        """
        positions = np.empty((len(points), 3))
        for axis in range(3):
            column = positions[:, axis]
            np.multiply(points["xyz"][:, axis], self.scales[axis], out=column)
            column += self.offsets[axis]
        attributes = self._standard(points)
        for extra in self.extras:
            attributes[extra.name] = _scaled(points[extra.name], extra)
        normals = None
        if self.has_normals:
            normals = np.stack([attributes.pop(n) for n in NORMALS], axis=1).astype(np.float64)
        colours: Numbers | None = None
        if self.point_format in _COLOURS_AT:
            colours = points["colours"].copy()
        return PointCloud(positions, normals, colours, attributes)

    def _standard(self, points: NDArray[np.void]) -> dict[str, Numbers]:
        is_new = self.point_format >= 6
        returns, classes, angles = (
            points[name] for name in ("returns", "classification", "scan_angle")
        )
        columns: dict[str, Numbers] = {
            "intensity": points["intensity"].copy(),
            "return_number": returns & (15 if is_new else 7),
            "number_of_returns": returns >> 4 if is_new else returns >> 3 & 7,
            "classification": classes.copy() if is_new else classes & 31,
            "scan_angle": angles.astype(np.float32) * np.float32(DEGREES_A_STEP if is_new else 1),
        }
        for name in ("user_data", "point_source_id", "gps_time", "near_infrared"):
            if name in (points.dtype.names or ()):
                columns[name] = points[name].copy()
        return columns


def _scaled(values: Numbers, extra: _Extra) -> Numbers:
    if extra.scale == 1 and extra.offset == 0:
        return values.copy()
    scaled: FloatArray = np.multiply(values, extra.scale) + extra.offset
    return scaled


def find_layout(header: LasHeader, path: Path) -> LasLayout:
    """Find out how the points of a file are decoded.

    Raise InputError where their format is unknown, or they do not fit into the records.
    """
    point_format = header.point_format
    if point_format >= len(SIZES):
        raise InputError(
            f"{path}: point format {point_format} is unknown",
            f"formats 0 to {len(SIZES) - 1} are read: export the file in one of them",
        )
    if header.record_length < SIZES[point_format]:
        raise InputError(
            f"{path}: the header is damaged: points of format {point_format} have "
            f"{SIZES[point_format]} bytes, not {header.record_length}",
            "export the file again",
        )
    fields: dict[str, Field] = {"xyz": (("<i4", 3), 0)}
    fields.update(_OLD if point_format < 6 else _NEW)
    for name, kind, places in (
        ("gps_time", "<f8", _GPS_TIME_AT),
        ("colours", ("<u2", 3), _COLOURS_AT),
        ("near_infrared", "<u2", _NEAR_INFRARED_AT),
    ):
        if point_format in places:
            fields[name] = (kind, places[point_format])
    extras = _add_extras(header, fields)
    dtype = np.dtype(
        {
            "names": list(fields),
            "formats": [kind for kind, _ in fields.values()],
            "offsets": [offset for _, offset in fields.values()],
            "itemsize": header.record_length,
        }
    )
    return LasLayout(point_format, dtype, header.scales, header.offsets, tuple(extras))


def _add_extras(header: LasHeader, fields: dict[str, Field]) -> list[_Extra]:
    """Add the columns of the extra bytes that are described, and lie within the record."""
    extras: list[_Extra] = []
    taken = {*fields, *AXES, *COLOURS, "return_number", "number_of_returns"}
    at = SIZES[header.point_format]
    payload = header.records.get(("LASF_Spec", 4), b"")
    rows = len(payload) // _DESCRIPTION.itemsize
    for row in np.frombuffer(payload[: rows * _DESCRIPTION.itemsize], _DESCRIPTION):
        kind = int(row["type"])
        if not 1 <= kind <= 3 * len(_EXTRA_TYPES):
            at += int(row["options"]) if kind == 0 else 0  # bytes of which nothing is known
            continue
        dtype = np.dtype(_EXTRA_TYPES[(kind - 1) % len(_EXTRA_TYPES)])
        components = (kind - 1) // len(_EXTRA_TYPES) + 1
        if at + components * dtype.itemsize > header.record_length:
            break
        stem = find_role(bytes(row["name"]).decode("latin-1")) or "extra"
        for i in range(components):
            name = _free_name(stem if components == 1 else f"{stem}_{i}", taken)
            fields[name] = (dtype, at)
            at += dtype.itemsize
            options = int(row["options"])
            extras.append(
                _Extra(
                    name,
                    float(row["scale"][i]) if options & _HAS_SCALE else 1.0,
                    float(row["offset"][i]) if options & _HAS_OFFSET else 0.0,
                )
            )
    return extras


def _free_name(name: str, taken: set[str]) -> str:
    number = 1
    free = name
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    taken.add(free)
    return free
