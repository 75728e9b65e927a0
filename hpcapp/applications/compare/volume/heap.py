"""The volume of heaps over the base that their rims tell, and how sure it is.

Of a polygon, heights inside come from the points inside alone, and those of the ground from the
points outside alone: a toe is sharp. The base is what the ground round the polygon is continued to
(`base.py`). Uncertain are noise, what the ground does below the heap, where the polygon lies, and
what no point shows.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from math import hypot
from typing import Any

import numpy as np
from scipy.ndimage import binary_dilation, label

from hpcapp.applications.compare.volume.base import Base, fit_base, interpolate
from hpcapp.geometry.points import BoolArray, FloatArray, PointCloud
from hpcapp.geometry.regions.prism import load_shapely
from hpcapp.io.outlines import Drawn
from hpcapp.terrain.cover import cover_cells
from hpcapp.terrain.epoch import PER_CELL, Epoch
from hpcapp.terrain.errors import CONFIDENCE, LIKELY
from hpcapp.terrain.heights import Heights, fit_heights
from hpcapp.terrain.lattice import Lattice
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError, UsageError
from hpccomponent.ranges import is_place

log = logging.getLogger("hpcapp")

RIM, FLAT = "rim", "plane"
"""What a base may be, beside a height."""
_MOST_CELLS = 10_000  # of one polygon: its base is solved for
_MOST_WITH_RIM = 200_000  # of its box, with what it is widened by
_FEWEST_CELLS = 12  # inside, and on the rim
_RING = 0.05
"""Width of a ring by which a polygon is grown, of the radius of a disc of its area."""
_MOST_RINGS = 5  # that may be part of the heap: a foot that was cut off
_AFTER = 3  # rings that tell what lies beyond
_STILL = 0.005  # of a volume: what a ring may add to one that stays
_KNOWN_RIM = 0.5  # share of the cells round a polygon that need ground
_HALF = 0.5  # of a cell: one that is covered by less has no height
_BY_HALVES = 4.0 / 3.0
"""Of what a volume changes by with cells half as wide: its error goes with the square of them."""
_PEAK = 1.0 / 3.0
"""Of slope times width: by how much what is hidden is higher than it is filled; a hidden tip of a
cone is by a fifth."""


@dataclass(frozen=True, slots=True)
class Heap:
    """The volume of one heap; lengths in the unit of x and y.

    Parameters
    ----------
    name : str
    volume : float
        Of what lies above the base, less what lies below.
    uncertainty : float
        At the confidence, either way: of `from_noise` and `from_base` the root of the sum of the
        squares, beside the others.
    from_noise, from_base, from_polygon, from_hidden, from_cells : float
        What noise makes of it; what the ground may do below the heap; what the volume changes by
        when the polygon is grown; what no point shows; and what is finer than cells.
    area : float
        Of the polygon.
    height : float
        Of the highest cell above the base.
    hidden : float
        Area inside that has no points: it is filled from around.
    grown : float
        By how much the polygon was grown until the volume stayed: its foot was cut off.
    is_still : bool
        Whether it stayed.
    cell : float
        Width of a cell.
    confidence : float
        Share of the volumes that are within their uncertainty.
    """

    name: str
    volume: float
    uncertainty: float
    from_noise: float
    from_base: float
    from_polygon: float
    from_hidden: float
    from_cells: float
    area: float
    height: float
    hidden: float
    grown: float
    is_still: bool
    cell: float
    confidence: float = CONFIDENCE

    @property
    def is_significant(self) -> bool:
        """Whether it is more than its uncertainty."""
        return abs(self.volume) > self.uncertainty


@dataclass(frozen=True, slots=True, eq=False)
class _Sum:
    """The volume within one outline: its parts, as `Heap` has them, and the mean of its base."""

    volume: float
    variance: float
    from_base: float
    from_hidden: float
    height: float
    hidden: float
    level: float


def measure_heaps(
    ground: Epoch,
    polygons: Sequence[Drawn],
    above: str | float = RIM,
    cell: float | None = None,
    registration: float | None = None,
) -> list[Heap]:
    """Measure what lies above a base within polygons.

    Parameters
    ----------
    above : str or float
        ``rim``: what the heights round the polygon are continued to; ``plane``: the plane through
        them; or a height, in the unit of heights of the file.
    cell : float, optional
        Width of a cell; by default as the points around need.
    registration : float, optional
        Standard deviation of the place of a polygon against the points; by default it is grown as
        long as that adds to the volume, by a tenth to a half of its radius.

    Raises
    ------
    InputError
        There are too few points in a polygon, or hardly any round it.
    UsageError
        `above` is none of these.
    """
    level = _read_level(above)
    origin = ground.surface.origin
    turned = ground.turn("z", origin)
    if level is not None:
        level = level * ground.crs.height_scale - origin[2]
    shapely = load_shapely()
    heaps = []
    for number, drawn in enumerate(polygons, 1):
        shape = shapely.transform(drawn.shape, lambda places: places - origin[:2])
        name = drawn.name or (f"heap {number}" if len(polygons) > 1 else "heap")
        heaps.append(
            _measure(turned, shape, name, above if level is None else level, cell, registration)
        )
    return heaps


def _read_level(above: str | float) -> float | None:
    if above in (RIM, FLAT):
        return None
    try:
        level = float(above)
    except ValueError:
        level = np.nan
    if not is_place(level):
        raise UsageError(
            f"{name_option('above', above)}: it is no base",
            f"give {RIM}, {FLAT} or a height",
        )
    return level


def _measure(
    ground: Epoch, shape: Any, name: str, above: str | float, cell: float | None,
    registration: float | None,
) -> Heap:  # fmt: skip
    radius = float(shape.area / np.pi) ** 0.5
    need = _take_near(ground, shape.buffer(0.5 * radius), name).choose_step()
    # a height is no ground that a foot would end at: the polygon counts as it is drawn
    known = 0.0 if registration is None and not isinstance(above, str) else registration
    low, high = np.array(shape.bounds).reshape(2, 2)
    beyond = _list_growths(radius, 0.0, known)[-1]
    least = (float(np.prod(high - low + 2.0 * beyond)) / _MOST_WITH_RIM) ** 0.5
    width = cell or max(need, least, (shape.area / _MOST_CELLS) ** 0.5)
    if width < least:
        raise UsageError(
            f"{name}: cells {width:.3g} wide are more than {_MOST_WITH_RIM:,}",
            f"give {name_option('cell')} {least:.2g} or more, or a smaller "
            f"{name_option('registration')}",
        )
    growths = _list_growths(radius, width, known)
    margin = growths[-1] + 3.0 * width
    near = _take_near(ground, shape.buffer(margin), name)
    lattice = Lattice.over(low - margin, high + margin, width)
    scan = _Scan.of(near, lattice, need / PER_CELL**0.5)
    sums = [scan.sum_volume(shape, above, name)]
    for growth in growths[1:]:
        try:
            sums.append(scan.sum_volume(shape.buffer(growth), above, name))
        except InputError:  # the survey ends there
            break
        last = _find_still(sums)
        if known is None and last is not None and len(sums) > last + _AFTER:
            break
    still = _find_still(sums) if known is None else 0
    own = sums[still or 0]
    from_polygon = max(abs(one.volume - own.volume) for one in sums[still or 0 :])
    if known is None:  # what seems to stay may go on, and what does not is not at its end
        from_polygon = max(from_polygon, _STILL * abs(own.volume)) * (
            1.0 if still is not None else 2.0
        )
    from_noise = LIKELY * own.variance**0.5
    outline = shape.buffer(growths[still or 0])
    fine = _Scan.of(near, Lattice.over(low - margin, high + margin, 0.5 * width), scan.spacing)
    wide, narrow = (one.sum_volume(outline, own.level, name).volume for one in (scan, fine))
    from_cells = _BY_HALVES * abs(wide - narrow)
    return Heap(
        name, own.volume,
        hypot(from_noise, own.from_base) + from_polygon + own.from_hidden + from_cells,
        from_noise, own.from_base, from_polygon, own.from_hidden, from_cells, float(shape.area),
        own.height, own.hidden, growths[still or 0], still is not None, width,
    )  # fmt: skip


def _list_growths(radius: float, width: float, registration: float | None) -> list[float]:
    """Return by how much a polygon is grown: not at all, and one ring after the other."""
    if registration is not None:
        return [0.0, 0.5 * LIKELY * registration, LIKELY * registration] if registration else [0.0]
    ring = max(_RING * radius, 0.5 * width)
    return [k * ring for k in range(_MOST_RINGS + _AFTER + 1)]


def _find_still(sums: Sequence[_Sum]) -> int | None:
    """Return the first ring after which the volume stays; None where there is none."""
    for k in range(min(len(sums) - 1, _MOST_RINGS + 1)):
        change = abs(sums[k + 1].volume - sums[k].volume)
        noise = LIKELY * abs(sums[k + 1].variance - sums[k].variance) ** 0.5
        if change <= max(noise, _STILL * abs(sums[k].volume)):
            return k
    return None


def _take_near(ground: Epoch, around: Any, name: str) -> Epoch:
    """Return the points in the box of a polygon; a mesh as it is."""
    if not isinstance(ground.surface, PointCloud):
        return ground
    low, high = np.array(around.bounds).reshape(2, 2)
    places = ground.surface.positions
    is_near = ((places[:, :2] >= low) & (places[:, :2] <= high)).all(axis=1)
    if not is_near.any():
        raise InputError(
            f"{ground.name}: no points in {name}",
            "draw the polygon over the scan, in its coordinate reference system",
        )
    return replace(ground, surface=PointCloud(places[is_near]))


@dataclass(frozen=True, slots=True, eq=False)
class _Scan:
    """The points or the mesh around one polygon, and a lattice."""

    points: FloatArray | None
    mesh: Heights | None
    lattice: Lattice
    spacing: float
    is_covered: BoolArray

    @classmethod
    def of(cls, ground: Epoch, lattice: Lattice, spacing: float) -> _Scan:
        if isinstance(ground.surface, PointCloud):
            points = ground.surface.positions
            cover = cover_cells(points, spacing, lattice)
            return cls(points, None, lattice, spacing, cover >= _HALF)
        heights = ground.read_heights(lattice, spacing)
        return cls(None, heights, lattice, spacing, heights.cover >= _HALF)

    def sum_volume(self, shape: Any, above: str | float, name: str) -> _Sum:
        """Return the volume within an outline; InputError where its heights or its rim lack."""
        lattice = self.lattice
        share, offset = _share_cells(shape, lattice, self.mesh is None)
        inner, outer = self._fit_sides(shape)
        areas = lattice.step**2 * share
        is_in = share > 0.0
        is_known = is_in & np.isfinite(inner.values) & self.is_covered
        if np.count_nonzero(is_known) < _FEWEST_CELLS:
            raise InputError(
                f"{name}: the scan shows {np.count_nonzero(is_known)} cells of it, "
                f"{lattice.step:.3g} wide",
                "draw the polygon over the scan, or give more points",
            )
        slopes = _find_slopes(inner.planes, lattice.step)
        tops = inner.values + (slopes * offset).sum(axis=-1)
        tops = interpolate(tops, is_known, is_in)
        base = self._find_base(
            above, areas, outer.values, outer.variances, is_in, share < 1.0, name
        )
        heights = np.where(is_in, tops - base.heights, 0.0)
        variance = float((areas**2 * inner.variances)[is_known].sum()) + base.variance
        hidden = is_in & ~is_known
        return _Sum(
            float((areas * heights).sum()), variance, base.uncertainty,
            _bound_hidden(hidden, areas, heights, slopes, is_in),
            float(heights[is_known].max()), float(areas[hidden].sum()),
            float((areas * base.heights).sum() / areas.sum()),
        )  # fmt: skip

    def _fit_sides(self, shape: Any) -> tuple[Heights, Heights]:
        """Return the heights of what lies inside, and of what lies outside."""
        if self.mesh is not None:
            return self.mesh, self.mesh
        assert self.points is not None  # noqa: S101 - it is one or the other
        shapely = load_shapely()
        shapely.prepare(shape)
        is_in = shapely.intersects_xy(shape, self.points[:, 0], self.points[:, 1])
        return self._fit(self.points[is_in]), self._fit(self.points[~is_in])

    def _fit(self, points: FloatArray) -> Heights:
        if len(points):
            return fit_heights(points, self.lattice, self.spacing)
        none = np.full(self.lattice.shape, np.nan)
        return Heights(none, none, none, np.zeros(none.shape), np.zeros(none.shape, dtype=bool))

    def _find_base(
        self, above: str | float, areas: FloatArray, heights: FloatArray, variances: FloatArray,
        is_in: BoolArray, is_out: BoolArray, name: str,
    ) -> Base:  # fmt: skip
        if not isinstance(above, str):
            return Base(np.full(areas.shape, above), 0.0, 0.0)
        rim = binary_dilation(is_in, np.ones((3, 3))) & is_out
        is_known = rim & np.isfinite(heights) & self.is_covered
        parts, count = label(is_in | rim)
        known = np.bincount(parts[is_known], minlength=count + 1)[1:]
        every = np.bincount(parts[rim], minlength=count + 1)[1:]
        if (known < np.maximum(_KNOWN_RIM * every, _FEWEST_CELLS)).any():
            raise InputError(
                f"{name}: the scan shows the ground in {known.sum()} of {every.sum()} cells "
                "round it",
                "draw the polygon where there are points around it, or give the height of the base "
                f"as {name_option('above', 12.5)}",
            )
        return fit_base(
            above == RIM, areas, heights, variances, is_in | rim, is_known, self.lattice
        )


def _share_cells(shape: Any, lattice: Lattice, is_exact: bool) -> tuple[FloatArray, FloatArray]:
    """Return the share of each cell inside, and where its middle is from the cell's, (..., 2).

    Cells of what has heights at their middles only are in or out as a whole.
    """
    shapely = load_shapely()
    middles = lattice.middles
    share = shapely.contains_xy(shape, middles[..., 0], middles[..., 1]).astype(np.float64)
    offset = np.zeros(middles.shape)
    if not is_exact:
        return share, offset
    half = 0.5 * lattice.step
    boxes = shapely.box(
        middles[..., 0] - half,
        middles[..., 1] - half,
        middles[..., 0] + half,
        middles[..., 1] + half,
    )
    border = shape.boundary
    shapely.prepare(border)
    is_cut = shapely.intersects(border, boxes)
    parts = shapely.intersection(boxes[is_cut], shape)
    share[is_cut] = shapely.area(parts) / lattice.step**2
    centres = shapely.get_coordinates(shapely.centroid(parts[share[is_cut] > 0.0]))
    offset[is_cut & (share > 0.0)] = centres - middles[is_cut & (share > 0.0)]
    return share, offset


def _find_slopes(planes: FloatArray, step: float) -> FloatArray:
    """Return the slopes of heights along x and y, (rows, columns, 2); 0 where nothing tells one."""
    slopes = np.zeros((*planes.shape, 2))
    for k, axis in enumerate((1, 0)):
        rise = np.diff(planes, axis=axis) / step
        none = np.full_like(planes.take([0], axis=axis), np.nan)
        both = np.stack([np.concatenate(pair, axis=axis) for pair in ((none, rise), (rise, none))])
        count = np.isfinite(both).sum(axis=0)
        slopes[..., k] = np.nansum(both, axis=0) / np.maximum(count, 1)
    return slopes


def _bound_hidden(
    hidden: BoolArray, areas: FloatArray, heights: FloatArray, slopes: FloatArray,
    is_in: BoolArray,
) -> float:  # fmt: skip
    """Return within what the volume of cells that no point shows is known, hole by hole."""
    parts, count = label(hidden)
    total = 0.0
    for k in range(1, count + 1):
        part = parts == k
        around = binary_dilation(part, np.ones((3, 3))) & is_in & ~hidden
        area = float(areas[part].sum())
        if not around.any():
            continue
        steep = float(np.sqrt(np.mean((slopes[around] ** 2).sum(axis=-1))))
        spread = max(0.5 * float(np.ptp(heights[around])), _PEAK * steep * area**0.5)
        total += area * spread
    return total
