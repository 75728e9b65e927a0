"""The volume between two epochs of a terrain: differences of heights, cell by cell."""

from __future__ import annotations

from dataclasses import replace
from math import hypot

import numpy as np
from scipy.ndimage import binary_erosion, maximum_filter, minimum_filter, uniform_filter

from hpcapp.applications.compare.volume.changed import Rise, find_changed, find_least
from hpcapp.applications.compare.volume.measure import Change, Volume, name_shift
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.terrain.errors import (
    LIKELY,
    Registration,
    find_narrowest,
    find_registration,
)
from hpcapp.terrain.heights import PLANE, Heights
from hpcapp.terrain.lattice import Lattice

FEWEST_CELLS = 30
"""Common cells that tell noise and registration."""
_FEWEST_BLOCKS = 30  # whose sums tell a variance to a quarter
_SMOOTH = 5  # cells across which a slope is told
_OTHER_BORDER = 0.75  # of a cell, by which two scans of one border do not differ
_TURNED = 1.15
"""What a shift is said to make of a volume, by what it makes of cells that stay cut or fill: it
turns some from one to the other. Where a yard is moved by half a metre, cuts are off by .92 to 1.02
of what is said with 1, and by .82 to .90 with this."""
_HIDDEN = 0.8
"""Volume of what is told no change but is one, in deviations of the volume of all that is common:
of a twenty-fifth of the ground a change is told from four deviations of that part on."""


def measure_terrain(
    new: Heights, old: Heights, border: float, lattice: Lattice, registration: float | None
) -> Change:
    """Measure what changed between two grids of heights, whose border is known within so much."""
    cover = _find_common(new.cover, old.cover)
    is_common = (cover > 0.0) & np.isfinite(new.values + old.values)
    area = lattice.step**2
    areas = area * cover * is_common
    rises = np.where(is_common, new.values - old.values, 0.0)
    # a mesh tells no noise: what the tenth that agrees best differs by is the least there is
    least = find_narrowest(rises[is_common]) ** 2
    variances = np.where(is_common, np.maximum(new.variances + old.variances, least), 0.0)
    effects = _find_effects(0.5 * (new.planes + old.planes), is_common, lattice.step)
    lie = find_registration(
        (new.planes - old.planes)[is_common], effects[is_common],
        np.sqrt(variances[is_common] / PLANE),
        np.array([lattice.step, lattice.step, np.inf]), registration,
    )  # fmt: skip
    stayed = np.zeros_like(is_common)
    stayed[is_common] = lie.stayed
    wider = _find_inflation(areas * (rises - effects @ lie.shift), areas**2 * variances, stayed)
    rise = Rise(areas * rises, wider * areas**2 * variances, is_common)
    side = find_changed(rise)
    unsure = border * lattice.step * np.abs(rises) * (
        is_common & ~binary_erosion(is_common)
    ) + areas * _find_mixed(rises, side)
    cut, fill, net = (
        _sum_volume(rise, areas, effects, lie, unsure, is_in)
        for is_in in (side < 0, side > 0, side != 0)
    )
    usual = float(np.sqrt(np.median(variances[is_common])))
    least = find_least(float(np.sqrt(wider)) * usual, int(is_common.sum()))
    noise = float((rises - effects @ lie.shift)[stayed].std()) if stayed.any() else usual
    return Change(
        replace(cut, volume=abs(cut.volume)), fill, net, float(areas.sum()),
        area * float(np.maximum(new.cover - cover, 0.0).sum()),
        area * float(np.maximum(old.cover - cover, 0.0).sum()),
        float(areas[new.is_layered | old.is_layered].sum()),
        name_shift(lie.shift), float(lie.stayed.mean()), registration, noise, least, lattice.step,
    )  # fmt: skip


def _find_common(new: FloatArray, old: FloatArray) -> FloatArray:
    """Return the share of each cell that both cover.

    One border that both have is told twice: it is between. The lesser one would leave out what the
    other one knows.
    """
    is_other = maximum_filter(np.abs(new - old), 3) > _OTHER_BORDER
    return np.where(is_other, np.minimum(new, old), 0.5 * (new + old))


def _sum_volume(
    rise: Rise, areas: FloatArray, effects: FloatArray, lie: Registration, unsure: FloatArray,
    is_in: BoolArray,
) -> Volume:  # fmt: skip
    moved = (areas[..., None] * effects)[is_in].sum(axis=0)
    hidden = _HIDDEN * rise.find_deviation(rise.is_common)
    noise = LIKELY * float(np.sqrt(rise.find_deviation(is_in) ** 2 + lie.find_variance(moved)))
    bias = lie.find_bias(moved)
    return Volume(
        float(rise.volumes[is_in].sum()),
        hypot(noise, hidden) + _TURNED * bias + float(unsure[is_in].sum()),
        bias, float(areas[is_in].sum()),
    )  # fmt: skip


def _find_mixed(rises: FloatArray, side: IntArray) -> FloatArray:
    """Return how much cut and fill cancel in cells between them, as heights.

    Of a cell that is crossed by the line between both, where the rise grows by g from side to side,
    g / 8 is cut and g / 8 is fill.
    """
    has_both = (maximum_filter(side, 3) > 0) & (minimum_filter(side, 3) < 0)
    mixed: FloatArray = has_both * np.hypot(*np.gradient(rises)) / 8.0
    return mixed


def _find_inflation(residual: FloatArray, sums: FloatArray, stayed: BoolArray) -> float:
    """Return by how much sums scatter more than expected, of the widest blocks that show it."""
    most, width = 1.0, 1
    while True:
        rows, columns = (-(-side // width) for side in residual.shape)
        row, column = np.nonzero(stayed)
        block = (row // width) * columns + column // width
        total = np.bincount(block, residual[stayed], rows * columns)
        expected = np.bincount(block, sums[stayed], rows * columns)
        is_told = expected > 0.0
        if np.count_nonzero(is_told) < _FEWEST_BLOCKS:
            return most
        most = max(most, float((total[is_told] ** 2 / expected[is_told]).mean()))
        width *= 2


def _find_effects(heights: FloatArray, is_common: BoolArray, step: float) -> FloatArray:
    """Return what shifts along x, y and z add to the height of each cell, zero where none is."""
    level = float(heights[is_common].mean())
    known = uniform_filter(is_common.astype(np.float64), _SMOOTH, mode="constant")
    filled = np.where(is_common, heights - level, 0.0)
    smooth = uniform_filter(filled, _SMOOTH, mode="constant") / np.maximum(known, 1e-9)
    across, along = np.gradient(smooth, step)
    slopes = np.stack([-along, -across, np.ones_like(along)], axis=-1)
    effects: FloatArray = slopes * is_common[..., None]
    return effects
