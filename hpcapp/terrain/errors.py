"""How two epochs lie to each other, told by the ground that did not change.

Where nothing changed, the second epoch is the first one moved by a small shift, and the rest is
noise. Ground that rose everywhere alike cannot be told from a shift: the shift is never taken off,
it is uncertainty. Of several shifts that a part of the ground agrees upon the least one counts:
surveys are registered as well as people could.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from hpcapp.geometry.points import BoolArray, FloatArray
from hpccomponent.dataclass import dataclass

CONFIDENCE = 0.95
"""Of the uncertainties that are said."""
LIKELY = float(norm.isf(0.5 - 0.5 * CONFIDENCE))
"""Standard deviations within which such a share of a normal distribution is."""
STAYED = 3.0
"""Standard deviations within which nothing changed: of noise 3 in 1,000 are beyond."""
_TO_DEVIATION = 1.0 / float(norm.isf(0.25))  # from the median of absolute errors
_ROUNDS = 50
_AXES = 3
_AGREED = 0.1
"""Share of the pieces that has to agree upon a shift: so much stays as it was, it is supposed."""
_WIDEST = 2.0
"""Of the noise that ground which agrees has, in what its densest tenth tells: twice as much is
change, not noise."""
_TRIED = 50_000  # pieces that tell which shifts there may be
_ROUNDING = 1e-9  # of the extent of the differences: no noise is less


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """How the new epoch lies to the old one.

    Parameters
    ----------
    shift : ndarray of float64, shape (e,)
        Of the new epoch, where nothing changed: along x, y and z, then an offset of all of its
        surface, where that is none of these. Zero where no ground agrees upon one.
    bias : ndarray of float64, shape (e,)
        What of it makes volumes uncertain: nothing where the user vouches for the registration.
    covariance : ndarray of float64, shape (e, e)
        Of the bias.
    stayed : ndarray of bool, shape (n,)
        The pieces that the shift explains.
    """

    shift: FloatArray
    bias: FloatArray
    covariance: FloatArray
    stayed: BoolArray

    def find_bias(self, effects: FloatArray) -> float:
        """Return what the shift makes of a volume, either way; of its effects, shape (e,)."""
        return abs(float(effects @ self.bias))

    def find_variance(self, effects: FloatArray) -> float:
        """Return the variance that a volume has by it."""
        return float(effects @ self.covariance @ effects)


def find_registration(
    change: FloatArray,
    effect: FloatArray,
    deviation: FloatArray,
    farthest: FloatArray,
    vouched: float | None,
) -> Registration:
    """Find the least shift that explains a part of the differences.

    Parameters
    ----------
    change : ndarray of float64, shape (n,)
        How far the new surface is in front of the old one.
    effect : ndarray of float64, shape (n, e)
        What a unit of each part of a shift adds.
    deviation : ndarray of float64, shape (n,)
        Of the differences, up to a factor.
    farthest : ndarray of float64, shape (e,)
        Shifts beyond these are none that differences can tell.
    vouched : float, optional
        Standard deviation of the shift along each axis, as control points tell it; by default
        what is measured.
    """
    least = _ROUNDING * float(np.ptp(change)) + np.finfo(np.float64).tiny
    deviation = np.maximum(deviation, least)
    z, effects = change / deviation, effect / deviation[:, None]
    few = slice(None, None, -(-len(z) // _TRIED))
    starts = [0.0, *np.quantile(change[few], np.arange(0.5 * _AGREED, 1.0, _AGREED)).tolist()]
    narrow = max(find_narrowest(change[few]) / float(np.median(deviation)), 1.0)
    tried = [
        _fit_shift(z[few], effects[few], start / deviation[few], narrow, farthest)
        for start in starts
    ]
    agreed = [shift for shift, stayed, _ in tried if stayed.mean() >= _AGREED]
    shift, stayed, scale = np.zeros(effect.shape[1]), np.zeros(len(z), dtype=bool), 1.0
    if agreed:
        least_one = min(agreed, key=lambda one: float(np.median(np.abs(effect[few] @ one))))
        shift, stayed, scale = _fit_shift(z, effects, effects @ least_one, narrow, farthest)
    if vouched is not None:
        known = np.diag(np.where(np.arange(len(shift)) < _AXES, vouched**2, 0.0))
        return Registration(shift, np.zeros(len(shift)), known, stayed)
    # a direction of which the surface tells nothing adds nothing to what it bounds either
    told = effects[stayed] * (shift != 0.0)
    inverse = np.linalg.pinv(told.T @ told, rcond=1e-12, hermitian=True)
    covariance: FloatArray = inverse.astype(np.float64) * scale**2
    return Registration(shift, shift, covariance, stayed)


def find_narrowest(change: FloatArray) -> float:
    """Return the standard deviation that the narrowest tenth of some differences tells."""
    ordered = np.sort(change)
    count = max(int(_AGREED * len(ordered)), 1)
    # of a normal distribution such a part lies within so many deviations of its middle
    within = float(norm.ppf(0.5 + 0.5 * _AGREED))
    return 0.5 * float((ordered[count:] - ordered[:-count]).min()) / within


def _fit_shift(
    z: FloatArray, effects: FloatArray, start: FloatArray, scale: float, farthest: FloatArray
) -> tuple[FloatArray, BoolArray, float]:
    """Return the shift that is fitted to what agrees with it, and what does, from a start on."""
    shift, is_told = np.zeros(effects.shape[1]), np.ones(effects.shape[1], dtype=bool)
    residual = np.abs(z - start)
    widest = _WIDEST * scale
    stayed = residual <= STAYED * scale
    for _ in range(_ROUNDS):
        if np.count_nonzero(stayed) <= len(shift):
            return shift, np.zeros(len(z), dtype=bool), scale
        told = effects[stayed] * is_told
        normal = np.linalg.pinv(told.T @ told, rcond=1e-12, hermitian=True)
        shift = normal.astype(np.float64) @ (told.T @ z[stayed])
        # level ground tells nothing of a shift along it, and noise would have it anywhere
        is_told &= np.abs(shift) <= farthest
        shift = shift * is_told
        residual = np.abs(z - effects @ shift)
        scale = min(max(_TO_DEVIATION * float(np.median(residual[stayed])), 1.0), widest)
        last, stayed = stayed, residual <= STAYED * scale
        if np.array_equal(last, stayed):
            break
    # a part of a slope, not a peak, is no ground that agrees: of a slope half are within half
    is_peak = 1.5 * np.count_nonzero(stayed) > np.count_nonzero(residual <= 2.0 * STAYED * scale)
    return shift, stayed & is_peak, scale
