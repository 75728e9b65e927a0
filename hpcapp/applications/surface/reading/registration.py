"""Whether scans of one scene fit together, told where two of them have a piece of surface at once.

In cells of a few spacings a plane is fitted to the points of each scan. Where two scans have one in
the same cell they should be the same plane. Of scans that were registered nine planes in ten and
more are; of scans a few spacings or degrees apart less than half. Scans that are farther apart have
hardly a plane in the same cell: larger cells are asked where these share too few. Planes that were
seen from opposite sides are two sides of a wall, and not compared.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.reading.reach import EvenSample
from hpcapp.geometry.lattice import number_keys, pack_places
from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpcapp.io.points.point_source import SCAN, Scan
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

Samples = Mapping[int, tuple[FloatArray, FloatArray]]

_CELLS = (5.0, 20.0)  # spacings of the sparsest scan: edges, the first that tell anything decide
_FARTHEST = 1e6  # edges from the middle: what is beyond is no part of a scene
_FEWEST = 8  # points of a scan in a cell, to fit a plane
_FLAT = 0.2  # share of the variance across a plane in the one along its shorter side
_ALIKE = np.cos(np.radians(25.0))  # of two normals
_NOISES, _EDGES = 1.5, 0.1  # of both planes' noise, and of a cell: how far apart they may be
_TELLING = 20  # cells that two scans share, at least
_MOST_SCANS = 256  # more numbers than that are of scan lines
AGREEING = 0.7
"""Of these, at least, where scans are registered: it parts the registered and the moved scans of
``benchmarks/decisions.py``."""


@dataclass(frozen=True, slots=True, eq=False)
class _ScanPlanes:
    """Planes of scans in cells, sorted by cell: p of them.

    `noises` are in length units of the input; `sides` are positive where the scanner was on the
    side of the normal, 0 where nothing tells.
    """

    cells: IntArray
    scans: IntArray
    centres: FloatArray
    normals: FloatArray
    noises: FloatArray
    sides: FloatArray


@dataclass(frozen=True, slots=True)
class PairOfScans:
    """Two scans, by number, that have a surface in so many cells, `agreeing` in some.

    `is_sided` says that it is known of all planes which side was seen.
    """

    first: int
    second: int
    cells: int
    agreeing: int
    is_sided: bool


def check_registration(chunks: Iterable[PointCloud], scans: Sequence[Scan]) -> str | None:
    """Tell which scans do not fit together, in a warning; None where all do.

    `chunks` have all points, each with the number of its scan in the attribute ``scan``; `scans`
    are what the file tells of them, by number; maybe not of all. It is a warning where two sides of
    thin walls may have been compared, InputError where the sides that scans saw are known.
    """
    samples = _sample(chunks, scans)
    if len(samples) < 2:
        return None
    pairs = compare_scans(samples)
    apart = [pair for pair in pairs if pair.agreeing < AGREEING * pair.cells]
    if not apart:
        return None
    worst = max(apart, key=lambda pair: pair.cells - pair.agreeing)
    problem = (
        f"scans {worst.first + 1} and {worst.second + 1} do not fit together: of {worst.cells} "
        f"places where both have a surface it is the same in {worst.agreeing / worst.cells:.0%}"
    )
    advice = "align them first (one file each: --align), or make a mesh of each by itself"
    if worst.is_sided:
        raise InputError(problem, advice)
    return f"{problem}; if these are not the two sides of thin walls, {advice}"


def compare_scans(samples: Samples) -> list[PairOfScans]:
    """Return what each two scans that overlap have in common, by number.

    A sample has points of a scan, and vectors to where they were seen from, or zeros.
    """
    spacing = max(estimate_spacing(places) for places, _ in samples.values())
    found: dict[tuple[int, int], PairOfScans] = {}
    for cell in _CELLS:
        planes = _fit_planes(samples, cell * spacing)
        is_sided = bool(planes.sides.all())
        pairs, cells, agreeing = _compare(planes, cell * spacing, len(samples))
        for row in np.flatnonzero(cells >= _TELLING).tolist():
            first, second = pairs[row].tolist()
            pair = PairOfScans(first, second, int(cells[row]), int(agreeing[row]), is_sided)
            found.setdefault((first, second), pair)
    return [found[numbers] for numbers in sorted(found)]


def _sample(chunks: Iterable[PointCloud], scans: Sequence[Scan]) -> Samples:
    """Return some points of each scan, and vectors to where they were seen from, or zeros."""
    samples: dict[int, tuple[EvenSample, EvenSample]] = {}
    for chunk in chunks:
        of_scan = chunk.attributes[SCAN]
        if of_scan.dtype.kind not in "iu":
            return {}
        for number in np.unique(of_scan).tolist():
            rows = np.flatnonzero(of_scan == number)
            places = chunk.positions[rows] + chunk.origin
            scanner = scans[number].scanner if 0 <= number < len(scans) else None
            if chunk.normals is not None:
                sides = chunk.normals[rows].astype(np.float64)
            else:
                sides = np.zeros_like(places) if scanner is None else scanner - places
            is_finite = (np.isfinite(places) & np.isfinite(sides)).all(axis=1)
            both = samples.setdefault(number, (EvenSample(), EvenSample()))
            for sample, values in zip(both, (places, sides), strict=True):
                sample.add(values[is_finite])
        if len(samples) > _MOST_SCANS:
            return {}
    found = {number: (a.positions, b.positions) for number, (a, b) in samples.items()}
    return {number: both for number, both in found.items() if _is_spread(both[0])}


def _is_spread(places: FloatArray) -> bool:
    """Tell whether a scan is more than a few points, or one place."""
    return len(places) >= _TELLING and bool((np.ptp(places, axis=0) > 0.0).any())


def _fit_planes(samples: Samples, edge: float) -> _ScanPlanes:
    """Fit a plane to the points of each scan in each cell where they are flat."""
    middle = np.median(np.concatenate([places for places, _ in samples.values()]), axis=0)
    found = []
    for number, (places, sides) in sorted(samples.items()):
        local = places - middle
        is_near = (np.abs(local) < _FARTHEST * edge).all(axis=1)
        local, sides = local[is_near], sides[is_near]
        cells, row = number_keys(pack_places(np.rint(local / edge).astype(np.int64)))
        counts = np.bincount(row, minlength=len(cells))
        means = _sum_rows(row, local) / counts[:, None]
        offsets = local - means[row]
        # (c, 9): the covariance of the points of each cell.
        products = (offsets[:, :, None] * offsets[:, None, :]).reshape(-1, 9)
        covariances = _sum_rows(row, products) / counts[:, None]
        variances, axes = np.linalg.eigh(covariances.reshape(-1, 3, 3))
        normals = axes[:, :, 0]
        good = (counts >= _FEWEST) & (variances[:, 0] < _FLAT * variances[:, 1])
        noises = np.sqrt(np.maximum(variances[:, 0], 0.0))
        towards = (_sum_rows(row, sides) * normals).sum(axis=1)
        scan = np.full(len(cells), number)
        found.append([each[good] for each in (cells, scan, means, normals, noises, towards)])
    columns = [np.concatenate(column) for column in zip(*found, strict=True)]
    order = np.argsort(columns[0], kind="stable")  # those of one cell by scan
    return _ScanPlanes(*(column[order] for column in columns))


def _sum_rows(row: IntArray, values: FloatArray) -> FloatArray:
    """Sum the rows of some values by the number of each."""
    return np.stack([np.bincount(row, column) for column in values.T], axis=1)


def _compare(planes: _ScanPlanes, edge: float, scans: int) -> tuple[IntArray, IntArray, IntArray]:
    """Compare the planes of each two scans.

    Returns the numbers of two scans (q, 2), how many cells both have (q,), and in how many of these
    they agree (q,).
    """
    pairs, agrees = [np.empty((0, 2), np.int64)], [np.empty(0, np.bool_)]
    for step in range(1, scans):
        # (m,): planes with another scan's, so many rows on, in the same cell.
        first = np.flatnonzero(planes.cells[step:] == planes.cells[:-step])
        second = first + step
        cosines = (planes.normals[first] * planes.normals[second]).sum(axis=1)
        # Those that were seen from opposite sides are left out; 0 where a side is not known.
        is_one_side = cosines * planes.sides[first] * planes.sides[second] >= 0.0
        first, second, cosines = first[is_one_side], second[is_one_side], cosines[is_one_side]
        # (m,): how far the second centre is from the first plane.
        between = planes.centres[second] - planes.centres[first]
        apart = np.abs((between * planes.normals[first]).sum(axis=1))
        allowed = _NOISES * (planes.noises[first] + planes.noises[second])
        agrees.append((np.abs(cosines) > _ALIKE) & (apart < np.maximum(allowed, _EDGES * edge)))
        pairs.append(np.stack([planes.scans[first], planes.scans[second]], axis=1))
    found, row = np.unique(np.concatenate(pairs), axis=0, return_inverse=True)
    row, count = row.reshape(-1), len(found)
    agreeing = np.bincount(row, np.concatenate(agrees), minlength=count)
    return found, np.bincount(row, minlength=count), agreeing.astype(np.int64)
