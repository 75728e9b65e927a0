"""The volume of heaps over the base that their rims tell, and how sure it is.

Of a polygon, heights inside come from the points inside alone, and those of the ground from the
points outside alone: a toe is sharp. The base is what the ground round the polygon is continued to
(`base.py`). Uncertain are noise, what the ground does below the heap, where the polygon lies, and
what no point shows.
"""

from __future__ import annotations

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
_UNSETTLED = 2.0  # times what widening adds, of a volume that does not stay
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
    """Measure what lies above a base within polygons, as `hpcapp.measure_heaps` says.

    A height is in the unit of heights of the file.
    """
    origin = ground.surface.origin
    turned = ground.turn("z", origin)
    base = _read_base(above)
    if not isinstance(base, str):
        base = base * ground.crs.height_scale - origin[2]
    shapely = load_shapely()
    heaps = []
    for number, drawn in enumerate(polygons, 1):
        shape = shapely.transform(drawn.shape, lambda places: places - origin[:2])
        name = drawn.name or (f"heap {number}" if len(polygons) > 1 else "heap")
        heaps.append(_measure(turned, shape, name, base, cell, registration))
    return heaps


def _read_base(above: str | float) -> str | float:
    if above in (RIM, FLAT):
        return above
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
    ground: Epoch, shape: Any, name: str, base: str | float, cell: float | None,
    registration: float | None,
) -> Heap:  # fmt: skip
    # a height is no ground that a foot would end at: the polygon counts as it is drawn
    known = 0.0 if registration is None and not isinstance(base, str) else registration
    radius = float(shape.area / np.pi) ** 0.5
    around = np.array(shape.buffer(0.5 * radius).bounds).reshape(2, 2)
    need = _take_near(ground, around, name).choose_step()
    box = np.array(shape.bounds).reshape(2, 2)
    farthest = _list_growths(radius, 0.0, known)[-1]
    width = _choose_width(cell, max(need, (shape.area / _MOST_CELLS) ** 0.5), box, farthest, name)
    growths = _list_growths(radius, width, known)
    box = box + np.array([[-1.0], [1.0]]) * (growths[-1] + 3.0 * width)
    near, spacing = _take_near(ground, box, name), need / PER_CELL**0.5
    sums = _sum_rings(_Scan.over(near, box, width, spacing), shape, base, name, growths, known)
    found = _find_still(sums) if known is None else 0
    still = found or 0
    own = sums[still]
    fine = _Scan.over(near, box, 0.5 * width, spacing)
    narrow = fine.sum_volume(shape.buffer(growths[still]), own.level, name)
    from_polygon = max(abs(one.volume - own.volume) for one in sums[still:])
    if known is None:  # what seems to stay may go on, and what does not is not at its end
        from_polygon = max(from_polygon, _STILL * abs(own.volume))
        from_polygon *= _UNSETTLED if found is None else 1.0
    from_noise = LIKELY * own.variance**0.5
    from_cells = _BY_HALVES * abs(own.volume - narrow.volume)
    return Heap(
        name, own.volume,
        hypot(from_noise, own.from_base) + from_polygon + own.from_hidden + from_cells,
        from_noise, own.from_base, from_polygon, own.from_hidden, from_cells, float(shape.area),
        own.height, own.hidden, growths[still], found is not None, width,
    )  # fmt: skip


def _choose_width(
    cell: float | None, need: float, box: FloatArray, beyond: float, name: str
) -> float:
    """Return the width of cells: as asked for or needed, but not too many in a box that is widened.

    Raise UsageError where those asked for are.
    """
    least = (float(np.prod(np.ptp(box, axis=0) + 2.0 * beyond)) / _MOST_WITH_RIM) ** 0.5
    if cell is not None and cell < least:
        raise UsageError(
            f"{name}: cells {cell:.3g} wide are more than {_MOST_WITH_RIM:,}",
            f"give {name_option('cell')} {least:.2g} or more, or a smaller "
            f"{name_option('registration')}",
        )
    return cell or max(need, least)


def _sum_rings(
    scan: _Scan, shape: Any, base: str | float, name: str, growths: Sequence[float],
    known: float | None,
) -> list[_Sum]:  # fmt: skip
    """Return the volume of a polygon, and as it is grown until that has stayed, or ground ends."""
    sums = [scan.sum_volume(shape, base, name)]
    for growth in growths[1:]:
        try:
            sums.append(scan.sum_volume(shape.buffer(growth), base, name))
        except InputError:  # the survey ends there
            break
        still = _find_still(sums)
        if known is None and still is not None and len(sums) > still + _AFTER:
            break
    return sums


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


def _take_near(ground: Epoch, box: FloatArray, name: str) -> Epoch:
    """Return the points in a box, with its low and its high corner, (2, 2); a mesh as it is."""
    if not isinstance(ground.surface, PointCloud):
        return ground
    places = ground.surface.positions
    is_near = ((places[:, :2] >= box[0]) & (places[:, :2] <= box[1])).all(axis=1)
    if not is_near.any():
        raise InputError(
            f"{ground.name}: no points in {name}",
            "draw the polygon over the scan, in its coordinate reference system",
        )
    return replace(ground, surface=PointCloud(places[is_near]))


@dataclass(frozen=True, slots=True, eq=False)
class _Scan:
    """The points or the mesh around one polygon, and a lattice.

    Of points, `cover` is the share of each cell that they cover, (rows, columns). A mesh has
    `faces`, heights of whole cells, which no polygon parts.
    """

    points: FloatArray
    lattice: Lattice
    cover: FloatArray
    faces: Heights | None

    @classmethod
    def over(cls, ground: Epoch, box: FloatArray, width: float, spacing: float) -> _Scan:
        lattice = Lattice.over(box[0], box[1], width)
        if isinstance(ground.surface, PointCloud):
            cover = cover_cells(ground.positions, spacing, lattice)
            return cls(ground.positions, lattice, cover, None)
        faces = ground.read_heights(lattice, spacing)
        return cls(ground.positions, lattice, faces.cover, faces)

    def sum_volume(self, shape: Any, base: str | float, name: str) -> _Sum:
        """Return the volume within an outline; InputError where its heights or its rim lack."""
        lattice = self.lattice
        # (rows, columns) each, with two numbers more of places and slopes
        share, offset = _share_cells(shape, lattice, self.faces is None)
        areas, is_in = lattice.step**2 * share, share > 0.0
        inner, outer = self._fit_sides(shape)
        is_known = is_in & (inner.cover >= _HALF)
        if np.count_nonzero(is_known) < _FEWEST_CELLS:
            raise InputError(
                f"{name}: the scan shows {np.count_nonzero(is_known)} cells of it, "
                f"{lattice.step:.3g} wide",
                "draw the polygon over the scan, or give more points",
            )
        # heights of the top where the middle of what is inside of a cell is, hidden ones filled
        slopes = _find_slopes(inner.planes, lattice.step)
        tops = interpolate(inner.values + (slopes * offset).sum(axis=-1), is_known, is_in)
        below = self._find_base(base, areas, outer, share < 1.0, name)
        heights = np.where(is_in, tops - below.heights, 0.0)
        hidden = is_in & ~is_known
        return _Sum(
            float((areas * heights).sum()),
            float((areas**2 * inner.variances)[is_known].sum()) + below.variance,
            below.uncertainty, _bound_hidden(hidden, areas, heights, slopes, is_in),
            float(heights[is_known].max()), float(areas[hidden].sum()),
            float((areas * below.heights).sum() / areas.sum()),
        )  # fmt: skip

    def _fit_sides(self, shape: Any) -> tuple[Heights, Heights]:
        """Return the heights of what lies inside, and of what lies outside."""
        if self.faces is not None:
            return self.faces, self.faces
        shapely = load_shapely()
        shapely.prepare(shape)
        is_in = shapely.intersects_xy(shape, *self.points[:, :2].T)
        inner, outer = (
            fit_heights(self.points[of], self.lattice, self.cover) for of in (is_in, ~is_in)
        )
        return inner, outer

    def _find_base(
        self, base: str | float, areas: FloatArray, ground: Heights, is_out: BoolArray, name: str
    ) -> Base:
        if not isinstance(base, str):
            return Base(np.full(areas.shape, base), 0.0, 0.0)
        is_in = areas > 0.0
        rim = binary_dilation(is_in, np.ones((3, 3))) & is_out
        is_known = rim & (ground.cover >= _HALF)
        # (parts,): the cells round each part of the polygon, those with ground and all
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
        return fit_base(base == RIM, areas, ground, is_in | rim, is_known, self.lattice)


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
    low, high = middles - 0.5 * lattice.step, middles + 0.5 * lattice.step
    boxes = shapely.box(low[..., 0], low[..., 1], high[..., 0], high[..., 1])
    border = shape.boundary
    shapely.prepare(border)
    is_cut = shapely.intersects(border, boxes)
    # (c,): what of each cell on the border is inside
    parts = shapely.intersection(boxes[is_cut], shape)
    share[is_cut] = shapely.area(parts) / lattice.step**2
    centres = shapely.get_coordinates(shapely.centroid(parts[share[is_cut] > 0.0]))
    offset[is_cut & (share > 0.0)] = centres - middles[is_cut & (share > 0.0)]
    return share, offset


def _find_slopes(planes: FloatArray, step: float) -> FloatArray:
    """Return the slopes of heights along x and y, (rows, columns, 2); 0 where nothing tells one."""
    slopes = []
    for axis in (1, 0):
        rises = np.diff(planes, axis=axis, prepend=np.nan, append=np.nan) / step
        # (2, rows, columns): from the cell before, and to the one behind
        both = np.stack([np.delete(rises, end, axis) for end in (-1, 0)])
        slopes.append(np.nansum(both, axis=0) / np.maximum(np.isfinite(both).sum(axis=0), 1))
    return np.stack(slopes, axis=-1)


def _bound_hidden(
    hidden: BoolArray, areas: FloatArray, heights: FloatArray, slopes: FloatArray,
    is_in: BoolArray,
) -> float:  # fmt: skip
    """Return within what the volume of cells that no point shows is known, hole by hole."""
    parts, count = label(hidden)
    total = 0.0
    for part in (parts == k for k in range(1, count + 1)):
        around = binary_dilation(part, np.ones((3, 3))) & is_in & ~hidden
        if not around.any():  # a part of the polygon of which the scan shows nothing
            around = is_in & ~hidden
        area = float(areas[part].sum())
        steep = float(np.sqrt(np.mean((slopes[around] ** 2).sum(axis=-1))))
        total += area * max(0.5 * float(np.ptp(heights[around])), _PEAK * steep * area**0.5)
    return total
