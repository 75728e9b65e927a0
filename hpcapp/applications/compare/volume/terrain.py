"""The volume between two epochs of a terrain: differences of heights, cell by cell."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter

from hpcapp.applications.compare.volume.errors import Samples
from hpcapp.applications.compare.volume.lattice import PLANES_PER_POINT, Heights, Lattice
from hpcapp.applications.compare.volume.measure import Change, measure_samples, name_shift
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray

FEWEST_CELLS = 100
"""Common cells that tell noise and registration, with those of double the width, too."""
_SMOOTH = 5  # cells across which a slope is told


def measure_terrain(
    new: Heights, old: Heights, lattice: Lattice, registration: float | None
) -> tuple[Change, IntArray]:
    """Measure what changed between two grids of heights.

    Parameters
    ----------
    registration : float, optional
        See `find_errors`.

    Returns
    -------
    change : Change
    side : ndarray of int64, shape (rows, columns)
        1 where it was filled, -1 where it was cut, else 0.
    """
    has_new, has_old = np.isfinite(new.values), np.isfinite(old.values)
    is_common = has_new & has_old
    area = lattice.step**2
    rows, columns = np.nonzero(is_common)
    relief = (new.relief + old.relief)[is_common]
    samples = Samples(
        (new.values - old.values)[is_common],
        _find_effects(0.5 * (new.values + old.values), is_common, lattice.step),
        np.stack([columns, rows, np.zeros_like(rows)], axis=1).astype(np.float64),
        area,
        _find_spread((new.variances + old.variances)[is_common] + relief / PLANES_PER_POINT),
        relief,
    )
    errors, side, (cut, fill, net) = measure_samples(samples, _pair_cells(is_common), registration)
    whole = np.zeros(lattice.shape, dtype=np.int64)
    whole[is_common] = side
    change = Change(
        cut, fill, net, area * len(rows),
        area * int(np.count_nonzero(has_new & ~has_old)),
        area * int(np.count_nonzero(has_old & ~has_new)),
        area * int(np.count_nonzero(is_common & (new.is_layered | old.is_layered))),
        name_shift(errors.shift), registration, errors.noise,
        float(np.median(errors.detect(samples))), lattice.step,
    )  # fmt: skip
    return change, whole


def _find_effects(heights: FloatArray, is_common: BoolArray, step: float) -> FloatArray:
    """Return what shifts of a ground along x, y and z add to its height at the common cells."""
    level = float(heights[is_common].mean())
    known = uniform_filter(is_common.astype(np.float64), _SMOOTH, mode="constant")
    filled = np.where(is_common, heights - level, 0.0)
    smooth = uniform_filter(filled, _SMOOTH, mode="constant") / np.maximum(known, 1e-9)
    across, along = np.gradient(smooth, step)
    slopes = np.stack([-along, -across, np.ones_like(along)], axis=-1)
    effects: FloatArray = slopes[is_common]
    return effects


def _find_spread(variances: FloatArray) -> FloatArray:
    """Return the noise of each cell in that of a usual one, which no cell is better than."""
    usual = float(np.median(variances))
    if usual == 0.0:
        return np.ones(len(variances))
    return np.sqrt(np.maximum(variances / usual, 1.0))


def _pair_cells(is_common: BoolArray) -> IntArray:
    """Return the pairs of common cells that touch, by their numbers."""
    number = np.where(is_common, np.cumsum(is_common).reshape(is_common.shape) - 1, -1)
    pairs = [
        np.stack([first.ravel(), second.ravel()], axis=1)
        for first, second in (
            (number[:, :-1], number[:, 1:]),
            (number[:-1], number[1:]),
            (number[:-1, :-1], number[1:, 1:]),
            (number[1:, :-1], number[:-1, 1:]),
        )
    ]
    every = np.concatenate(pairs)
    return every[(every >= 0).all(axis=1)]
