"""What the columns of a file hold, by their values: nothing is taken for what it is not.

A look at the points decides, once for all parts of a file: which colours they have, whether the
normals are some, which places are those of missing returns, whether x and y are degrees, and where
the points were measured from.

=================================  ==========================================================
found                              done
=================================  ==========================================================
colours of 16 bit, or from 0 to 1  scaled to 8 bit; 8-bit colours in wider fields stay
colours that are all zero          left out
colours of other values            left out, with a warning
normals that are all zero          left out, with a warning
normals that hold (n + 1) / 2      decoded, with a warning
colours in the place of normals    taken for colours, with a warning
other vectors off the surface      left out, with a warning
many points at the origin, or any  dropped and counted, with a warning
where all others are far from it
many points at another same place  dropped and counted, with a warning
a coordinate that is no data       dropped and counted, with a warning (see `no_data`)
a height called a depth            taken down where most are positive, with a warning
degrees                            a warning
numbers too coarse for the points  a warning (see `precision`)
whole metres                       a warning: they may be millimetres
points measured from above         the source says so (see `survey`)
=================================  ==========================================================
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.point_records import PointRecords
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.geometry.validity import are_finite
from hpcapp.io.batches import join_points
from hpcapp.io.columns import Numbers
from hpcapp.io.crs import Crs
from hpcapp.io.frame import finite_bounds
from hpcapp.io.geocentric import find_upright
from hpcapp.io.points.column_roles import (
    ColourScale,
    counts_down,
    judge_colours,
    judge_normals,
)
from hpcapp.io.points.no_data import (
    find_at,
    find_no_data,
    leave_out,
    may_be_data,
    name_no_data,
    sum_coordinates,
)
from hpcapp.io.points.point_source import Findings, PointSource, Read, translated
from hpcapp.io.points.precision import find_lost_digits
from hpcapp.io.points.survey import EVIDENCE, is_flown_over, is_projected
from hpccomponent.dataclass import dataclass

_ROWS = 1 << 16  # of a part that is looked at
_ENOUGH_PARTS, _MOST_PARTS = 2, 64  # looked at where nothing is in doubt, and where something is
_THIN = 16  # one row in so many is kept of the parts after the first
_LOOKED_AT = ("normals", "colours", *EVIDENCE)  # beside positions
_RUNS = 64  # over a file that is read from any row on

_BRIGHT = 63  # no 16-bit colours are all below this, or 0
_OVERSHOOT = 0.05  # of colours from 0 to 1 that were computed

_TREE_ROWS, _NEIGHBOURS = 20_000, 12
_FEWEST_TO_DOUBT = 10  # points: fewer say nothing of a surface
_NARROWEST = 1e-3  # of a plane: the square of its second extent over that of its first
_AGREEMENT = 0.8  # |cos| between normals and the planes of the neighbours

_METRIC = ("E57", "LAS", "LAZ", "COPC")  # formats; what states no unit there is in metres
_WIDEST_IN_METRES = 100.0  # of what is measured to whole ones
_STEEPEST = 1000.0  # z's extent over those of x and y: a relief of 1 % in metres over degrees
_GEOGRAPHIC = re.compile(r"^\s*(GEOGCS|GEOGCRS|GEODCRS)|^(EPSG:)?(4326|4269|4258|4979)$", re.I)
_DEGREES = {"lon", "long", "lng", "longitude", "lat", "latitude"}

Use = Literal["normals", "encoded", "encoded bytes", "colours", "nothing"]
"""What the columns of normals are used for."""

_ENCODED = {"encoded": 1.0, "encoded bytes": 255.0}  # what stands for 1 in (n + 1) / 2


@dataclass(frozen=True, slots=True, eq=False)
class _Decisions:
    """What is done to each part of a file.

    Colours are scaled, where there are some; missing (k, 3) are the places of missing returns and
    of no data, as of `find_no_data`; positive depths become heights.
    """

    colours: ColourScale | None
    normals: Use
    missing: FloatArray
    are_depths: bool

    def apply(self, part: PointCloud, findings: Findings) -> PointCloud:
        """Return a part as it is meant, and count what is dropped of it."""
        colours = part.normals if self.normals == "colours" else part.colours
        normals = None if self.normals in ("colours", "nothing") else part.normals
        if normals is not None and self.normals in _ENCODED:
            normals = 2 * normals / _ENCODED[self.normals] - 1
        scaled = None
        if colours is not None and self.colours is not None:
            scaled = _scale_colours(colours, self.colours)
        meant = replace(part, normals=normals, colours=scaled)
        dropped = np.zeros(len(part), np.bool_)
        for place in self.missing:
            is_there = find_at(part.positions, place) & ~dropped
            if is_there.any():
                reason, line = name_no_data(place)
                findings.warn(line)
                findings.drop(reason, int(is_there.sum()))
                dropped |= is_there
        if self.are_depths:
            meant = replace(meant, positions=part.positions * (1.0, 1.0, -1.0))
        return meant.take(~dropped) if dropped.any() else meant


def recognise(source: PointSource) -> PointSource:
    """Find out what the columns of a file hold.

    The reader gave colours of any type, and normals as they are named; in the parts that are
    returned colours are uint8, and normals are some. There are `records` only where a point is what
    they say. What is odd is in the findings; what is dropped is counted anew by each pass.

    Of a file that is read from any row on, 64 runs of rows spread over it are looked at. Others are
    read from their start: so far as is certain, 131,072 rows or all at least, 4 million at most.
    """
    findings, counted = source.findings, dict(source.findings.dropped)
    with translated(source.path):
        seen = _look_through(source)
    finite = np.flatnonzero(are_finite(seen.positions))
    seen = seen if len(finite) == len(seen) else seen.take(finite)
    missing, doubts = find_no_data(seen, source.unit, source.crs, goes_on=source.records is None)
    for line in doubts:
        findings.warn(line)
    usable = leave_out(seen, missing)
    points = len(usable) if source.records is None else source.records.count  # from all of these
    if lost := find_lost_digits(usable.positions, points):
        findings.warn(lost)
    use: Use = "normals" if source.normals_from == "faces" else _judge_use(usable, findings)
    colours = usable.normals if use == "colours" else usable.colours
    scale = None if colours is None else _judge_scale(colours, findings)
    are_depths = counts_down(source.columns) and bool((usable.positions[:, 2] > 0.0).mean() > 0.5)
    if are_depths:
        findings.warn("z is a depth, which counts down: heights are its negative")
    decisions = _Decisions(scale, use, missing, are_depths)
    unit = _find_unit(source, usable.positions)

    def apply(read: Read) -> Read:
        def scan(rows: int) -> Iterator[PointCloud]:
            findings.dropped.clear()
            findings.dropped.update(counted)
            for part in read(rows):
                yield decisions.apply(part, findings)

        return scan

    records = _keep_records(source.records, decisions)
    return replace(
        source,
        has_normals=source.has_normals and use not in ("colours", "nothing"),
        scan=apply(source.scan),
        octree=None if source.octree is None else source.octree.through(apply),
        records=records,
        check_rest=None if records is None else source.check_rest,
        unit=unit,
        is_flown=is_flown_over(usable, unit, source.crs),
        is_projected=is_projected(usable, unit, source.crs),
        upright=find_upright(*finite_bounds(usable.positions), Crs(source.crs, unit)),
    )


def _keep_records(records: PointRecords | None, decisions: _Decisions) -> PointRecords | None:
    """Return where the points are; None where they are not used as they are there."""
    if records is None or len(decisions.missing) or decisions.are_depths:
        return None
    if decisions.normals not in ("normals", "nothing"):
        return None
    if decisions.colours and any(dtype != "|u1" for _, dtype in records.colours):
        return None
    return replace(
        records,
        normals=records.normals if decisions.normals == "normals" else (),
        colours=records.colours if decisions.colours else (),
    )


def _look_through(source: PointSource) -> PointCloud:
    """Return some of a file's points; all of them where they are few."""
    if source.records is not None:
        return join_points(list(_read_runs(source.records)))
    seen: list[PointCloud] = []
    for number, part in enumerate(source.scan(_ROWS)):
        evidence = {name: part.attributes[name] for name in EVIDENCE if name in part.attributes}
        part = replace(part, attributes=evidence)
        seen.append(part if number < _ENOUGH_PARTS else part.take(np.arange(0, len(part), _THIN)))
        if number + 1 == _MOST_PARTS or (
            number + 1 >= _ENOUGH_PARTS and _is_certain(join_points(seen), source)
        ):
            break
    return join_points(seen)


def _read_runs(records: PointRecords) -> Iterator[PointCloud]:
    if records.count <= _ROWS:
        yield records.read(0, records.count, _LOOKED_AT)
        return
    length = _ROWS // _RUNS
    for start in np.linspace(0, records.count - length, _RUNS).astype(int).tolist():
        yield records.read(start, start + length, _LOOKED_AT)


def _is_certain(seen: PointCloud, source: PointSource) -> bool:
    """Tell whether more points would change nothing of what these say."""
    finite = seen.take(are_finite(seen.positions))
    if not finite.positions.any() or may_be_data(finite, source.unit, source.crs):
        return False
    if seen.normals is not None and judge_normals(seen.normals) not in ("unit", "any length"):
        return False
    if seen.colours is None or seen.colours.dtype == np.uint8:
        return True
    scale = judge_colours(seen.colours)
    if scale == "8 bit":  # or dark ones of 16 bit
        return bool(seen.colours.max() > _BRIGHT)
    return scale == "16 bit" or (scale == "float" and bool((seen.colours % 1 > 0).any()))


def _judge_use(seen: PointCloud, findings: Findings) -> Use:
    """Find out what the columns of normals hold."""
    if seen.normals is None or not len(seen):
        return "normals"
    kind = judge_normals(seen.normals)
    is_constant = bool((seen.normals == seen.normals[0]).all())  # as programs fill a column
    if kind in ("unit", "any length") and not is_constant:
        return "normals"
    if kind == "zero":
        findings.warn("all normals are zero, or not finite: they are left out")
        return "nothing"
    if kind == "encoded":
        findings.warn("the normals hold (n + 1) / 2: they are decoded")
        return "encoded"
    if kind == "none" and judge_normals(seen.normals / 255) == "encoded":
        findings.warn("the normals hold (n + 1) / 2 as bytes: they are decoded")
        return "encoded bytes"
    if len(seen) < _FEWEST_TO_DOUBT or _fit_surface(seen.positions, seen.normals):
        return "normals"
    if kind == "none" and seen.colours is None and judge_colours(seen.normals) is not None:
        findings.warn("the columns of normals hold colours: they are taken for colours")
        return "colours"
    findings.warn("the normals do not stand on the surface: they are left out")
    return "nothing"


def _fit_surface(positions: FloatArray, normals: FloatArray) -> bool:
    """Tell whether vectors are across the planes of the points around them, if there are any."""
    from scipy.spatial import cKDTree  # few clouds are in doubt

    rows = np.flatnonzero(np.isfinite(normals).all(axis=1) & normals.any(axis=1))
    rows = rows[np.sort(np.unique(sum_coordinates(positions[rows]), return_index=True)[1])]
    if len(rows) < _FEWEST_TO_DOUBT:
        return True
    rows = rows[:: -(-len(rows) // _TREE_ROWS)]  # scan lines of a file's order are broken up
    places = _scale_to_box(positions[rows])
    _, neighbours = cKDTree(places).query(places, k=min(_NEIGHBOURS, len(rows)))
    arms = places[neighbours] - places[neighbours].mean(axis=1, keepdims=True)
    squares, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", arms, arms))
    is_plane = squares[:, 1] > _NARROWEST * squares[:, 2]
    units = normals[rows] / np.linalg.norm(normals[rows], axis=1, keepdims=True)
    cosines = np.abs(np.einsum("ni,ni->n", units, vectors[:, :, 0]))[is_plane]
    return not len(cosines) or bool(np.median(cosines) > _AGREEMENT)


def _scale_to_box(positions: FloatArray) -> FloatArray:
    """Return points in a box of about unit size: squares of any distance stay in range."""
    low, high = positions.min(axis=0) / 2, positions.max(axis=0) / 2
    half = float((high - low).max())  # halves: the whole may be beyond all numbers
    scaled: FloatArray = (positions / 2 - low) / half if half > 0 else positions * 0.0
    return scaled


def _judge_scale(colours: Numbers, findings: Findings) -> ColourScale | None:
    """Find out how colours are scaled; None where they are none."""
    known = colours[are_finite(colours)]
    if not known.any():  # the format has colours, the scan has not
        return None
    scale = judge_colours(known)
    if scale is not None:
        return scale
    least, most = float(known.min()), float(known.max())  # of numbers that need not be whole
    if least >= -_OVERSHOOT and most <= 1 + _OVERSHOOT:
        return "float"
    if least >= 0 and most <= 65535:
        return "8 bit" if most <= 255 else "16 bit"
    findings.warn(f"the colours go from {least:g} to {most:g}: they are left out")
    return None


def _scale_colours(colours: Numbers, scale: ColourScale) -> NDArray[np.uint8]:
    """Return colours as bytes."""
    if colours.dtype == np.uint8:
        return colours.astype(np.uint8, copy=False)
    whole = {"8 bit": 255, "16 bit": 65535, "float": 1}[scale]
    known: Numbers = np.nan_to_num(colours, nan=whole)  # white where there is none
    # Both 256 and 257 times a byte give the byte.
    scaled = known // 256 if scale == "16 bit" else np.rint(np.multiply(known, 255 / whole))
    as_bytes: NDArray[np.uint8] = np.clip(scaled, 0, 255).astype(np.uint8)
    return as_bytes


def _find_unit(source: PointSource, positions: FloatArray) -> str | None:
    """Return the unit of x and y, and warn of units that are odd."""
    warn = source.findings.warn
    if _look_like_millimetres(source, positions):
        warn(
            "all coordinates are whole numbers, as of millimetres, and are taken for metres, as "
            "the format has them: if they are millimetres, export the file in metres, or read the "
            "lengths of the result as millimetres"
        )
    if _are_degrees(source, positions):
        warn("x and y are in degrees: project them to metres, a surface in degrees is distorted")
        return "degree"
    if (factor := source.frame.height_scale) != 1.0:
        warn(
            f"x and y are in {source.unit}, heights in {source.height_unit}: heights are "
            f"multiplied by {factor:.5g} for the surface, which is written in the file's own "
            "coordinates"
        )
    return source.unit


def _look_like_millimetres(source: PointSource, positions: FloatArray) -> bool:
    """Tell whether the coordinates of a format that has metres are whole numbers, of a wide box."""
    are_metres = source.unit == "m" or (source.unit is None and source.format.startswith(_METRIC))
    if not are_metres or len(positions) < _FEWEST_TO_DOUBT:
        return False
    is_whole = all((column == np.rint(column)).all() for column in positions.T)
    return bool(is_whole and np.ptp(positions, axis=0).max() > _WIDEST_IN_METRES)


def _are_degrees(source: PointSource, positions: FloatArray) -> bool:
    """Tell whether x and y are longitude and latitude: as the file says, or as they look."""
    if source.unit is not None:
        return source.unit.startswith("deg")
    if source.crs is not None and _GEOGRAPHIC.search(source.crs):
        return True
    names = {name.strip().strip('"').lower() for name in source.columns}
    if names & _DEGREES and "x" not in names:
        return True
    if source.crs is not None or len(positions) < _FEWEST_TO_DOUBT:
        return False
    low, high = bound_points(positions)
    if (np.maximum(-low, high)[:2] > (180, 90)).any():
        return False

    def extent(column: FloatArray) -> float:
        low, high = np.quantile(column, (0.02, 0.98))
        return float(high - low)

    x = extent(positions[:, 0])
    if not 0 < _STEEPEST * x < high[2] - low[2]:  # as of nearly all
        return False
    y, z = extent(positions[:, 1]), extent(positions[:, 2])
    return y > 0 and z > _STEEPEST * max(x, y)
