"""A file of points that is read in parts: a cloud may be larger than memory.

Readers make the sources, `formats` opens them, and `recognition` says what their columns are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.point_records import PointRecords
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.geometry.regions.region import Area, Region, say_place
from hpcapp.io.batches import batch_points, cut_points, join_points
from hpcapp.io.crs import Crs
from hpcapp.io.frame import finite_bounds, scale_heights, to_local
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

Read = Callable[[int], Iterator[PointCloud]]
"""Given a number of rows, yields points in parts of so many, the last of fewer."""

_ROWS_AT_ONCE = 1 << 20
_SMALL = 1 << 16  # points

SCAN = "scan"
"""The attribute that has the number of each point's scan."""

CLASSES = "classification"
"""The attribute that has the class of each point, as of LAS."""

NOT_GROUND = "not_ground"
"""Why points are left out where the bare ground is asked for."""


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One set-up of a scanner, where a file tells them apart.

    Parameters
    ----------
    points : int or None
        How many it has; None where the file says nothing.
    scanner : ndarray of float64, shape (3,), or None
        Where the scanner stood, in the file's coordinates.
    grid : tuple of int or None
        Width and height of an organised scan, whose points have the attributes ``column`` and
        ``row``: points side by side in it are neighbours.
    """

    points: int | None = None
    scanner: FloatArray | None = None
    grid: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Octree:
    """What a file knows of where its points are, so that it need not be read to its end.

    All points lie between low and high, (3,), as the file says. `read` takes a part of space, and
    returns what yields the points of the nodes that reach into it, in the file's order.
    """

    low: FloatArray
    high: FloatArray
    read: Callable[[Area], Read]

    def through(self, change: Callable[[Read], Read]) -> Octree:
        """Return one whose points go through what changes them."""
        return replace(self, read=lambda area: change(self.read(area)))


@dataclass(slots=True, eq=False)
class Findings:
    """What a reader has to say; complete when all points were read.

    Warnings are of one line, without the file's name: what is odd, and what was done about it.
    `dropped` counts the points that the reader left out, by reason.
    """

    warnings: list[str] = field(default_factory=list)
    dropped: dict[str, int] = field(default_factory=dict)

    def warn(self, warning: str) -> None:
        """Add a warning, once."""
        if warning not in self.warnings:
            self.warnings.append(warning)

    def drop(self, reason: str, points: int) -> None:
        """Count points that are left out."""
        if points:
            self.dropped[reason] = self.dropped.get(reason, 0) + points

    def lines(self) -> list[str]:
        """Return a line for each warning, and for each reason why points were dropped unasked."""
        dropped = [
            f"dropped {points} points: {reason}"
            for reason, points in self.dropped.items()
            if reason != NOT_GROUND
        ]
        return self.warnings + dropped


@dataclass(frozen=True, slots=True, eq=False)
class PointSource:
    """The points of a file, in its order and in its coordinates.

    Parameters
    ----------
    count : int or None
        How many points the file says it has; None where it says nothing.
    is_double : bool
        Whether coordinates may have more digits than float32 holds.
    scan : Read
        Of all of the file's points; a file without points is one empty part.
    records : PointRecords or None
        Where the points are; None where one must be read to find the next.
    check_rest : callable
        Finds out whether all of the file is as it should be, the points set aside; there with
        `records` only, and part of `scan`.
    format : str
        What the file is, for people: ``PLY, binary``.
    columns : tuple of str
        Its columns as the file names them, in its order.
    scans : tuple of Scan
        One where the file does not tell scans apart. Points of more than one have the
        attribute ``scan``, their number from 0.
    crs : str or None
        Coordinate reference system, as WKT or an EPSG code.
    unit : str or None
        Of the coordinates: ``m``, ``ft``, ``US ft``, ``mm``, ``degree``.
    normals_from : {"file", "faces"}
        Whether normals, where there are some, are the file's or those of a mesh's faces.
    oriented : bool
        False where the normals are known up to their sign only, as the axes of splats.
    is_flown : bool
        Whether what the file holds tells that the points were measured from above.
    is_projected : bool
        Whether x and y are coordinates of a map.
    upright : ndarray of float64, shape (3, 3), or None
        Rows to the east, to the north and up, where coordinates are from the centre of the earth.
    height_unit : str or None
        Of z, where it is stated of that alone.
    octree : Octree or None
        Where the file has one: of the same points as `scan`.
    region : Region or None
        Points beyond it are to be left out of `records`, as they are of the parts.
    """

    path: Path
    count: int | None
    is_double: bool
    has_normals: bool
    scan: Read
    records: PointRecords | None = None
    check_rest: Callable[[], None] | None = None
    format: str = ""
    columns: tuple[str, ...] = ()
    scans: tuple[Scan, ...] = (Scan(),)
    crs: str | None = None
    unit: str | None = None
    findings: Findings = field(default_factory=Findings)
    normals_from: Literal["file", "faces"] = "file"
    oriented: bool = True
    is_flown: bool = False
    is_projected: bool = False
    upright: FloatArray | None = None
    height_unit: str | None = None
    octree: Octree | None = None
    region: Region | None = None

    @property
    def frame(self) -> Crs:
        """What the file's coordinates mean."""
        return Crs(self.crs, self.unit, self.height_unit)

    @property
    def is_upright(self) -> bool:
        """Whether z is known to point up."""
        return self.is_flown or self.is_projected or bool(self.frame.text)

    @property
    def up(self) -> str:
        """Which way is up, and why: ``z (flown)``, ``unknown``."""
        if self.upright is not None:
            how = "flown, geocentric" if self.is_flown else "geocentric"
            return f"away from the centre of the earth ({how} coordinates)"
        if self.is_flown:
            return "z (flown)"
        return "z (projected coordinates)" if self.is_projected else "unknown"

    def chunks(self, rows: int) -> Iterator[PointCloud]:
        """Yield every point in parts of so many at most, to which memory is proportional.

        NaN and zero normals are included, the origin is zero. Raise InputError where the file is
        damaged, as `read_points` would say it; after the last part at the latest.
        """
        with translated(self.path):
            yield from self.scan(rows)

    def without_normals(self) -> PointSource:
        """Return the same points without the normals that the file has."""
        records = None if self.records is None else replace(self.records, normals=())

        def scan(rows: int) -> Iterator[PointCloud]:
            return (replace(part, normals=None) for part in self.scan(rows))

        return replace(self, scan=scan, has_normals=False, records=records, octree=None)

    def isotropic(self) -> PointSource:
        """Return the same points with z in the unit of x and y; `frame` stays that of the file."""
        factor = self.frame.height_scale
        if factor == 1.0:
            return self
        scales = (1.0, 1.0, factor)
        scans = [
            one if one.scanner is None else replace(one, scanner=one.scanner * scales)
            for one in self.scans
        ]

        def scan(rows: int) -> Iterator[PointCloud]:
            return (scale_heights(part, factor) for part in self.scan(rows))

        return replace(
            self, is_double=True, scan=scan, scans=tuple(scans), records=None, octree=None
        )

    def within(self, region: Area, margin: float = 0.0) -> PointSource:
        """Return the points in a region, and those around it that shape the surface at its edge.

        It is in the file's coordinates; the margin around it in `Area.longest`. Where there are no
        points, an InputError comes after the parts, with the extent of the file.
        """
        wide = region.widen(margin * region.longest)

        def scan(rows: int) -> Iterator[PointCloud]:
            return batch_points(self._cut(region, wide, max(rows, _SMALL)), rows)

        on_the_wire = wide.on_the_wire
        records = None if on_the_wire is None else self.records
        return replace(self, scan=scan, region=on_the_wire, records=records, octree=None)

    def of_classes(self, wanted: Sequence[int], unwanted: Sequence[int] = ()) -> PointSource:
        """Return the points of some classes; where none are wanted, of all but others.

        Where points have no classes, or none is left, an InputError comes with the parts.
        """

        def scan(rows: int) -> Iterator[PointCloud]:
            return batch_points(self._choose(wanted, unwanted, max(rows, _SMALL)), rows)

        return replace(self, scan=scan, records=None, octree=None)

    def _choose(
        self, wanted: Sequence[int], unwanted: Sequence[int], rows: int
    ) -> Iterator[PointCloud]:
        points, there = 0, set[int]()
        for part in self.scan(rows):
            classes = part.attributes.get(CLASSES)
            if classes is None:
                raise InputError(
                    f"{self.path}: the points have no classes",
                    f"leave {name_option('classes' if wanted else 'not_classes')} out, or export "
                    "the file with its classification",
                )
            is_kept = np.isin(classes, wanted) if wanted else ~np.isin(classes, unwanted)
            points += int(is_kept.sum())
            there |= set() if points else set(np.unique(classes[np.isfinite(classes)]).tolist())
            yield part if is_kept.all() else part.take(is_kept)
        if not points:
            raise InputError(
                f"{self.path}: no points are left by their classes",
                f"the file has {', '.join(f'{one:g}' for one in sorted(there)) or 'none'}",
            )

    def _cut(self, region: Area, wide: Area, rows: int) -> Iterator[PointCloud]:
        points, corners, read = 0, list[FloatArray](), self.scan
        if self.octree is not None:
            corners, read = [self.octree.low, self.octree.high], self.octree.read(wide)
        for part in read(rows):
            near = part.take(wide.find(part.positions))
            points += len(near)
            corners += finite_bounds(part.positions) if len(part) and not points else ()
            yield near
        if not points and corners:
            low, high = bound_points(np.stack(corners))
            raise InputError(
                f"{self.path}: no points in {region}",
                f"those of the file lie from {say_place(low)} to {say_place(high)}",
            )

    def check(self) -> None:
        """Find out, given `records`, whether all of the file but its points is as it should be."""
        assert self.check_rest is not None  # noqa: S101 - there are records
        with translated(self.path):
            self.check_rest()


def keep_small(source: PointSource) -> PointSource:
    """Decode a small file once for all passes: the process that does takes a while to start."""
    if source.count is None or source.count > _SMALL:
        return source
    kept: list[tuple[PointCloud, dict[str, int]]] = []

    def scan(rows: int) -> Iterator[PointCloud]:
        if not kept:
            (whole,) = source.scan(_SMALL)
            kept.append((whole, dict(source.findings.dropped)))
        whole, dropped = kept[0]
        source.findings.dropped.clear()
        source.findings.dropped.update(dropped)
        yield from cut_points(whole, rows)

    return replace(source, scan=scan, octree=None)


def read_whole(source: PointSource) -> PointCloud:
    """Read all points at once, and bring them into a local frame."""
    at_once = _ROWS_AT_ONCE if source.records is None else max(source.count or 0, 1)
    cloud = join_points(list(source.chunks(at_once)))
    positions, origin = to_local(cloud.positions)
    return replace(cloud, positions=positions, origin=origin)


@contextmanager
def translated(path: Path) -> Iterator[None]:
    """Turn the system's errors of reading a file into an InputError."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error.strerror or error}", "check the file's name"
        ) from error
