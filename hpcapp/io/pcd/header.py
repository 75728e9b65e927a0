"""The header of a PCD file: fields, their number of points and how these are stored."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError
from hpccomponent.ranges import is_place

_KEYWORDS = (
    "VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT",
    "POINTS", "DATA",
)  # fmt: skip
_ENCODINGS = ("ascii", "binary", "binary_compressed")
_TYPES = {"F": "f", "I": "i", "U": "u"}
_LONGEST_HEADER = 1 << 20
_MOST_NUMBERS = 1 << 20  # of one field in a point
_EXPORT_AGAIN = "export the file again"


@dataclass(frozen=True, slots=True)
class PcdField:
    """A field of the points, by the name that the file spells.

    Its numbers are of a dtype as numpy names it: ``<f4``; a point has `count` of them, from 0.
    """

    name: str
    dtype: str
    count: int

    @property
    def size(self) -> int:
        """Bytes of it in a point."""
        return int(np.dtype(self.dtype).itemsize) * self.count


@dataclass(frozen=True, slots=True, eq=False)
class PcdHeader:
    """What stands in front of the points.

    Parameters
    ----------
    grid : tuple of int or None
        Width and height of an organised cloud.
    scanner : ndarray of float64, shape (3,), or None
        Where the viewpoint is. At the origin without a rotation, as it is where nobody knows it,
        it is taken for one in organised clouds only, which are images of a camera there.
    encoding : str
        ``ascii``, ``binary`` or ``binary_compressed``.
    body_start, body_line : int
        Bytes in front of the body, and the number of its first line, from 1.
    warnings : tuple of str
        What is odd about the header.
    """

    fields: tuple[PcdField, ...]
    points: int
    grid: tuple[int, int] | None
    scanner: FloatArray | None
    encoding: str
    body_start: int
    body_line: int
    warnings: tuple[str, ...]


def read_pcd_header(path: Path) -> PcdHeader:
    """Read the header of a PCD file, of any version.

    Raise InputError where the file is empty, has no header, or a line of it is wrong.
    """
    with path.open("rb") as file:
        head = file.read(_LONGEST_HEADER)
    if not head:
        raise InputError(f"{path}: the file is empty", "export or copy it again")
    entries: dict[str, list[str]] = {}
    at = 0
    for number, line in enumerate(io.BytesIO(head), start=1):
        at += len(line)
        words = [word.decode("utf-8", "backslashreplace") for word in line.split()]
        if not words or words[0].startswith("#"):
            continue
        keyword = words[0].upper()
        if keyword not in _KEYWORDS:
            problem = (
                "no PCD header" if not entries else f"{words[0][:20]!r} is no part of a header"
            )
            raise InputError(
                f"{path}:{number}: {problem}", "a PCD file starts with VERSION, FIELDS .. DATA"
            )
        entries[{"COLUMNS": "FIELDS"}.get(keyword, keyword)] = words[1:]
        if keyword == "DATA":
            return _HeaderReader(path, entries).read(at, number + 1)
    raise InputError(f"{path}: the PCD header has no line DATA", _EXPORT_AGAIN)


class _HeaderReader:
    """Makes sense of the entries of a header."""

    def __init__(self, path: Path, entries: dict[str, list[str]]) -> None:
        self.path = path
        self.entries = entries

    def read(self, body_start: int, body_line: int) -> PcdHeader:
        """Return what the entries say."""
        encoding = " ".join(self.entries["DATA"]).lower()
        if encoding not in _ENCODINGS:
            raise self._wrong("DATA", f"is none of {', '.join(_ENCODINGS)}")
        width, height = self._whole("WIDTH"), self._whole("HEIGHT", [1])
        points = self._whole("POINTS", [width[0] * height[0]] if width else None)
        if not points:
            raise InputError(f"{self.path}: the PCD header has no line POINTS", _EXPORT_AGAIN)
        grid, warnings = None, []
        if width and width[0] * height[0] != points[0]:
            warnings.append(
                f"WIDTH {width[0]} and HEIGHT {height[0]} do not make {points[0]} POINTS: "
                "taken for a cloud without a grid"
            )
        elif width and width[0] > 1 and height[0] > 1:
            grid = (width[0], height[0])
        return PcdHeader(
            self._fields(), points[0], grid, self._scanner(grid is not None), encoding, body_start,
            body_line, tuple(warnings),
        )  # fmt: skip

    def _fields(self) -> tuple[PcdField, ...]:
        names = self.entries.get("FIELDS")
        if not names:
            raise InputError(f"{self.path}: the PCD header has no line FIELDS", _EXPORT_AGAIN)
        sizes = self._whole("SIZE", [4] * len(names), len(names))
        kinds = [kind.upper() for kind in self.entries.get("TYPE", ["F"] * len(names))]
        counts = self._whole("COUNT", [1] * len(names), len(names))
        if len(kinds) != len(names):
            raise self._wrong("TYPE", f"does not say one type for each of {len(names)} fields")
        fields = []
        for name, size, kind, count in zip(names, sizes, kinds, counts, strict=True):
            if kind not in _TYPES or size not in ((4, 8) if kind == "F" else (1, 2, 4, 8)):
                raise self._wrong("SIZE", f"makes {name!r} {size} bytes, which type {kind} has not")
            if count > _MOST_NUMBERS:
                raise self._wrong("COUNT", f"is {count} for field {name!r}")
            fields.append(PcdField(name, f"<{_TYPES[kind]}{size}", count))
        return tuple(fields)

    def _whole(self, key: str, default: Sequence[int] | None = None, items: int = 1) -> list[int]:
        """Return the whole numbers of an entry; nothing where it is not there, nor a default."""
        words = self.entries.get(key)
        if words is None:
            return list(default or ())
        if len(words) != items or not all(re.fullmatch("[0-9]{1,15}", word) for word in words):
            raise self._wrong(key, f"is not {items} whole number{'s' * (items > 1)}")
        return [int(word) for word in words]

    def _scanner(self, is_organised: bool) -> FloatArray | None:
        words = self.entries.get("VIEWPOINT", [])
        try:
            viewpoint = np.array([float(word) for word in words])
        except ValueError:
            raise self._wrong("VIEWPOINT", "is not 7 numbers") from None
        if len(viewpoint) != 7 or not is_place(*viewpoint):
            return None
        is_default = not viewpoint[:3].any() and not viewpoint[4:].any()
        return None if is_default and not is_organised else viewpoint[:3]

    def _wrong(self, key: str, problem: str) -> InputError:
        text = " ".join(self.entries[key])[:60]
        return InputError(f"{self.path}: PCD header: {key} {text!r} {problem}", _EXPORT_AGAIN)
