"""The outlines of sections, and the files that they are written to."""

from __future__ import annotations

from collections.abc import Iterator
from os import PathLike
from pathlib import Path

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.wording import say_count, say_number
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError

SUFFIXES = (".dxf", ".svg", ".geojson", ".json")


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """One line where a plane cuts a surface.

    Parameters
    ----------
    points : ndarray of float64, shape (n, 3)
        In the coordinates of the input.
    flat : ndarray of float64, shape (n, 2)
        In the drawing: to the right and upwards, heights in the unit of x and y.
    is_closed : bool
        Whether it is closed; its last point then is the first once more.
    """

    points: FloatArray
    flat: FloatArray
    is_closed: bool

    @property
    def length(self) -> float:
        """In the unit of x and y."""
        return float(np.linalg.norm(np.diff(self.flat, axis=0), axis=1).sum())

    @property
    def area(self) -> float:
        """What it encloses; less than zero round a hole, zero where it is open."""
        if not self.is_closed:
            return 0.0
        x, y = (self.flat - self.flat[0]).T
        return 0.5 * float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """The outlines of one section.

    Parameters
    ----------
    name : str
        The plane, or the station with the name of its line.
    station : float or None
        How far along its line it is.
    line : str
        The name of the line, or "".
    """

    name: str
    station: float | None
    line: str
    outlines: tuple[Outline, ...]

    @property
    def closed(self) -> int:
        """How many outlines are closed."""
        return sum(one.is_closed for one in self.outlines)

    @property
    def length(self) -> float:
        """Of all outlines."""
        return sum(one.length for one in self.outlines)

    @property
    def area(self) -> float:
        """What the closed outlines enclose, without holes."""
        return abs(sum(one.area for one in self.outlines))


@dataclass(frozen=True, slots=True, eq=False)
class Sections:
    """Sections of one surface; those that it does not reach have no outlines."""

    sections: tuple[Section, ...]
    crs: Crs = UNKNOWN

    def __len__(self) -> int:
        return len(self.sections)

    def __iter__(self) -> Iterator[Section]:
        return iter(self.sections)

    def __getitem__(self, index: int) -> Section:
        return self.sections[index]

    def describe(self) -> str:
        """Say how many outlines there are, and how many sections have none."""
        outlines = sum(len(one.outlines) for one in self)
        closed, empty = sum(one.closed for one in self), sum(not one.outlines for one in self)
        told = [
            say_count(len(self), "section"),
            f"{say_count(outlines, 'outline')}, {closed:,} of them closed",
        ]
        return "; ".join([*told, f"{empty:,} sections meet nothing"] if empty else told)

    def list_rows(self) -> list[tuple[str, str, str, str, str]]:
        """Return a table for people, with its head."""
        unit = self.crs.unit or ""
        return [("section", "outlines", "closed", "length", "area")] + [
            (
                one.name, str(len(one.outlines)), str(one.closed), say_number(one.length, unit),
                say_number(one.area, unit and f"{unit}²"),
            )
            for one in self
        ]  # fmt: skip

    def to_json(self) -> dict[str, object]:
        """Return the same as plain values."""
        sections = [
            {
                "name": one.name, "station": one.station, "line": one.line or None,
                "outlines": len(one.outlines), "closed": one.closed,
                "length": one.length, "area": one.area,
            }
            for one in self
        ]  # fmt: skip
        return {"sections": sections, "unit": self.crs.unit}

    def save(self, path: str | PathLike[str], *, flat: bool = False) -> None:
        """Write a drawing: ``.dxf`` or ``.geojson`` in place, ``.svg`` flat.

        With `flat` a ``.dxf`` is flat, too. Raise UsageError for another suffix, OutputError where
        the file cannot be written, and MissingLibraryError without ezdxf for a ``.dxf``.
        """
        from hpcapp.applications.section import drawings

        file = Path(path)
        check_drawing(file, flat)
        if file.suffix.lower() == ".dxf":
            drawings.write_dxf(file, self, flat)
        elif file.suffix.lower() == ".svg":
            drawings.write_svg(file, self)
        else:
            drawings.write_geojson(file, self)


def check_drawing(path: Path, is_flat: bool) -> None:
    """Raise UsageError where a file is no drawing, or none that can be flat."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(
            f"{path}: no drawing has this suffix", f"give one of {', '.join(SUFFIXES)}"
        )
    if is_flat and suffix in (".geojson", ".json"):
        raise UsageError(f"{path}: GeoJSON is in place, not flat", "give a .dxf or an .svg")
