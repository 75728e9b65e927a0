"""Legacy VTK files: the points of a data set, with their normals, colours and scalars.

::

    # vtk DataFile Version 3.0
    a title
    ASCII | BINARY                       (big endian)
    DATASET POLYDATA | ...
    POINTS n float                       then cells, which are passed over
    POINT_DATA n
    NORMALS name float | SCALARS name float 1 | COLOR_SCALARS name 3 | FIELD name k | ...

References
----------
"VTK File Formats", The VTK User's Guide, 11th edition, Kitware.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcapp.geometry.points import PointCloud
from hpcapp.io.columns import Numbers
from hpcapp.io.points.column_roles import AXES, find_role, judge_colours
from hpcapp.io.points.mesh_points import slice_cloud
from hpcapp.io.points.point_source import PointSource
from hpccomponent.errors import InputError

_TYPES = {
    "float": ">f4", "double": ">f8", "char": ">i1", "signed_char": ">i1", "unsigned_char": ">u1",
    "short": ">i2", "unsigned_short": ">u2", "int": ">i4", "unsigned_int": ">u4", "long": ">i8",
    "unsigned_long": ">u8", "vtktypeint64": ">i8", "vtktypeuint64": ">u8", "vtkidtype": ">i4",
}  # fmt: skip
_CELLS = ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS", "CELLS")
_POINT_SETS = ("POLYDATA", "UNSTRUCTURED_GRID", "STRUCTURED_GRID")
_LONGEST_LINE = 4096
_MOST_COLUMNS = 64  # of one array: more of them are a descriptor, not attributes

Column = Numbers


def open_vtk(path: Path) -> PointSource:
    """Open the points of a legacy VTK file: polydata, an unstructured or a structured grid.

    Scalars of a point are attributes by their names; cells are passed over. Raise InputError where
    the file is damaged, or no such data set.
    """
    reader = _Reader(path)
    reader.read()
    positions = reader.points.astype(np.float64)
    arrays = {name: a for name, a in reader.arrays.items() if len(a) == len(positions)}
    normals, colours, attributes = None, None, {}
    for name, values in arrays.items():
        if name == reader.normals:
            normals = values.astype(np.float64)
        elif colours is None and _are_colours(name, values):
            colours = np.ascontiguousarray(values[:, :3])
        elif values.shape[1] == 1:
            role = find_role(name)
            attributes[name if role in AXES else role] = values[:, 0]
        elif values.shape[1] <= _MOST_COLUMNS:
            attributes |= {f"{name}_{i}": column for i, column in enumerate(values.T)}
    return slice_cloud(path, reader.kind, PointCloud(positions, normals, colours, attributes))


def _are_colours(name: str, values: Column) -> bool:
    named = any(word in name.lower() for word in ("rgb", "color", "colour"))
    return named and values.shape[1] in (3, 4) and judge_colours(values) is not None


class _Reader:
    """Goes through a file from its start, section by section."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._bytes = path.read_bytes()
        self._at = 0
        self._is_binary = False
        self.kind = ""
        self.points: Column = np.zeros((0, 3))
        self.arrays: dict[str, Column] = {}
        self.normals: str | None = None

    def read(self) -> None:
        """Read the header, and every section up to the data of cells."""
        if not self._line().startswith("# vtk DataFile"):
            raise self._error("not a legacy VTK file", "its first line is '# vtk DataFile ...'")
        self._line()  # a title
        coding = self._line().strip().upper()
        if coding not in ("ASCII", "BINARY"):
            raise self._error(f"neither ASCII nor BINARY but {coding[:20]!r}", "export it again")
        self._is_binary = coding == "BINARY"
        words = self._words()
        if words[:1] != ["DATASET"] or words[1:2] == [] or words[1].upper() not in _POINT_SETS:
            raise self._error(
                f"no data set with points: {' '.join(words)[:60]!r}",
                "export it as polydata or an unstructured grid",
            )
        self.kind = f"VTK legacy, {coding.lower()}"
        has_points = False
        while (words := self._words()) and words[0].upper() != "CELL_DATA":
            has_points = has_points or words[0].upper() == "POINTS"
            self._section(words[0].upper(), words[1:])
        if not has_points:
            raise self._error("no POINTS", "check that the right file was exported")

    def _section(self, keyword: str, words: list[str]) -> None:
        if keyword == "POINTS":
            self.points = self._array(self._count(words, 0), 3, self._word(words, 1))
        elif keyword in _CELLS:
            self._skip_cells(self._count(words, 0), self._count(words, 1))
        elif keyword == "CELL_TYPES":
            self._array(self._count(words, 0), 1, "int")
        elif keyword in ("NORMALS", "VECTORS"):
            name = self._word(words, 0)
            self.arrays[name] = self._array(len(self.points), 3, self._word(words, 1))
            self.normals = name if keyword == "NORMALS" else self.normals
        elif keyword == "SCALARS":
            columns = self._count(words, 2) if len(words) > 2 else 1
            self._words()  # LOOKUP_TABLE
            kind = self._word(words, 1)
            self.arrays[self._word(words, 0)] = self._array(len(self.points), columns, kind)
        elif keyword == "COLOR_SCALARS":
            kind = "unsigned_char" if self._is_binary else "float"
            shape = len(self.points), self._count(words, 1)
            self.arrays[f"color_{self._word(words, 0)}"] = self._array(*shape, kind)
        elif keyword == "LOOKUP_TABLE":
            kind = "unsigned_char" if self._is_binary else "float"
            self._array(self._count(words, 1), 4, kind)
        elif keyword == "FIELD":
            for _ in range(self._count(words, 1)):
                head = self._words()
                shape = self._count(head, 2), self._count(head, 1)
                self.arrays[self._word(head, 0)] = self._array(*shape, self._word(head, 3))
        elif keyword == "METADATA":
            while self._line().strip():
                """Up to a blank line."""
        elif keyword not in ("POINT_DATA", "DIMENSIONS"):
            raise self._error(f"an unknown section {keyword[:40]!r}", "export it again as polydata")

    def _skip_cells(self, count: int, size: int) -> None:
        """Pass over cells: n and indices each, or, from version 5 on, offsets and indices."""
        before = self._at
        words = self._words()
        if words[:1] == ["OFFSETS"]:
            self._array(count, 1, self._word(words, 1))
            self._array(size, 1, self._word(self._words(), 1))
        else:
            self._at = before
            self._array(size, 1, "int")

    def _array(self, rows: int, columns: int, kind: str) -> Column:
        dtype = _TYPES.get(kind.lower())
        if dtype is None:
            raise self._error(f"an unknown type {kind[:40]!r}", "export it again")
        wanted = rows * columns
        values = self._binary(wanted, dtype) if self._is_binary else self._ascii(wanted, dtype)
        return values.reshape(rows, columns)

    def _binary(self, wanted: int, dtype: str) -> Column:
        size = wanted * np.dtype(dtype).itemsize
        if size > len(self._bytes) - self._at:
            raise self._truncated(wanted, (len(self._bytes) - self._at) // np.dtype(dtype).itemsize)
        values = np.frombuffer(self._bytes, dtype, wanted, self._at)
        self._at += size
        return values.astype(np.dtype(dtype).newbyteorder("="))

    def _ascii(self, wanted: int, dtype: str) -> Column:
        if wanted > len(self._bytes) - self._at:
            raise self._truncated(wanted, len(self._bytes[self._at :].split()))
        parts: list[Column] = []
        announced = wanted
        while wanted > 0:
            if self._at >= len(self._bytes):
                raise self._truncated(announced, announced - wanted)
            words = self._line().split()
            try:
                parts.append(np.array(words, np.float64))
            except ValueError:
                text = " ".join(words)[:60]
                raise self._error(f"not numbers: {text!r}", "export it again") from None
            wanted -= len(words)
        if wanted < 0:
            raise self._error("more numbers than announced", "export it again")
        values = np.concatenate(parts) if parts else np.zeros(0)
        return values if dtype[1] == "f" else values.astype(np.int64)

    def _line(self) -> str:
        end = self._bytes.find(b"\n", self._at)
        end = len(self._bytes) if end < 0 else end
        line = self._bytes[self._at : end]
        self._at = end + 1
        return line.decode("latin-1").rstrip("\r")

    def _words(self) -> list[str]:
        """Return the words of the next line that is not blank; none at the end of the file."""
        while self._at < len(self._bytes):
            if words := self._line()[:_LONGEST_LINE].split():
                return words
        return []

    def _word(self, words: list[str], index: int) -> str:
        if index >= len(words):
            raise self._error(f"a word is missing in {' '.join(words)[:60]!r}", "export it again")
        return words[index]

    def _count(self, words: list[str], index: int) -> int:
        word = self._word(words, index)
        if not (word.isascii() and word.isdecimal() and len(word) <= 12):
            raise self._error(f"not a count: {word[:20]!r}", "export it again")
        return int(word)

    def _truncated(self, announced: int, has_points: int) -> InputError:
        problem = f"truncated: {announced} numbers are announced, the file ends after {has_points}"
        return self._error(problem, "copy or export the file again")

    def _error(self, problem: str, advice: str) -> InputError:
        return InputError(f"{self._path}: {problem}", advice)
