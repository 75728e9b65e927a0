"""What noise and registration do to the difference of two epochs, told by what did not change.

Where nothing changed, the second epoch is the first one moved by a small shift, and the rest is
noise. The shift is fitted to the half that agrees best; the noise is what is left there, summed
over blocks of growing size, so that errors which neighbours share count as such. A rise of
everything alike cannot be told from a shift: it is uncertainty, and no change.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from hpcapp.geometry.lattice import pack_places
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpccomponent.dataclass import dataclass

CONFIDENCE = 0.95
"""Of the uncertainties that are said."""
LIKELY = float(norm.isf(0.5 - 0.5 * CONFIDENCE))
"""Standard deviations within which such a share of a normal distribution is."""
STAYED = 3.0
"""Standard deviations within which nothing changed: of noise 3 in 1,000 are beyond. With half or
double of it two volumes of three are wrong (`benchmarks/volumes.py`)."""
_TO_DEVIATION = 1.0 / float(norm.isf(0.25))  # from the median of absolute errors
_ROUNDS = 50
_AXES = 3
FEWEST_BLOCKS = 30  # whose sums tell a variance to a quarter
_ROUNDING = 1e-9  # of the extent of the differences: no noise is less


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Differences of two epochs, each of a piece of the surface.

    Parameters
    ----------
    change : ndarray of float64, shape (n,)
        How far the new surface is in front of the old one, in length units.
    effect : ndarray of float64, shape (n, e)
        What a unit of each systematic error adds: of a shift of the new epoch along x, y and z,
        then of an offset of all of its surface, where that is none of these.
    places : ndarray of float64, shape (n, 3)
        In widths of a piece.
    area : float
        Of a piece.
    spread : ndarray of float64, shape (n,)
        The noise of each, in that of a usual one.
    relief : ndarray of float64, shape (n,)
        What relief that was not scanned adds to the variance of a sum of changes, for each.
    """

    change: FloatArray
    effect: FloatArray
    places: FloatArray
    area: float
    spread: FloatArray
    relief: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """The errors of differences.

    Parameters
    ----------
    shift : ndarray of float64, shape (e,)
        Of the new epoch against the old one, where nothing changed.
    bias : ndarray of float64, shape (e,)
        What of it is in the volumes: nothing where the user vouches for the registration.
    covariance : ndarray of float64, shape (e, e)
        Of the bias.
    noise : float
        Standard deviation of a usual difference.
    density : float
        Variance of the sum of the noise over an area, by that area: length units to the fourth.
    """

    shift: FloatArray
    bias: FloatArray
    covariance: FloatArray
    noise: float
    density: float

    def sum_bias(self, samples: Samples, rows: IntArray) -> float:
        """Return what the bias makes of the volume that some samples have, either way."""
        return samples.area * float(abs(samples.effect[rows].sum(axis=0) @ self.bias))

    def sum_noise(self, samples: Samples, rows: IntArray) -> float:
        """Return the rest of the uncertainty of that volume."""
        owner = np.zeros(len(rows), dtype=np.int64)
        return LIKELY * float(self.find_deviations(samples, rows, owner, 1)[0])

    def find_deviations(
        self, samples: Samples, rows: IntArray, owner: IntArray, count: int
    ) -> FloatArray:
        """Return the standard deviations of so many volumes, less the bias.

        Parameters
        ----------
        rows : ndarray of int64, shape (r,)
            The samples that make the volumes.
        owner : ndarray of int64, shape (r,)
            The volume that each belongs to.
        """
        columns = [np.bincount(owner, axis[rows], count) for axis in samples.effect.T]
        area = samples.area * np.bincount(owner, minlength=count)
        variance = samples.area**2 * (
            self._spread(np.stack(columns, axis=1))
            + np.bincount(owner, samples.relief[rows], count)
        )
        deviations: FloatArray = np.sqrt(variance + self.density * area)
        return deviations

    def detect(self, samples: Samples) -> FloatArray:
        """Return the smallest change of each sample, less the bias, that is none of the noise.

        So far away that, at that `CONFIDENCE`, none among as many samples is by noise alone.
        """
        far = float(norm.isf(0.5 * (1.0 - CONFIDENCE) / len(samples.change)))
        noise = self.noise * samples.spread
        limits: FloatArray = far * np.sqrt(self._spread(samples.effect) + noise**2)
        return limits

    def _spread(self, effect: FloatArray) -> FloatArray:
        spread: FloatArray = np.einsum("ij,jk,ik->i", effect, self.covariance, effect)
        return spread


def find_errors(samples: Samples, registration: float | None) -> Errors:
    """Tell the errors of differences by those that are no change.

    Parameters
    ----------
    registration : float, optional
        Standard deviation of the shift along each axis, in length units, as control points tell
        it; by default what is measured.
    """
    shift, stayed = _fit_shift(samples)
    residual = samples.change - samples.effect @ shift
    density = _sum_noise(samples, residual, stayed)
    noise = float(np.sqrt(((residual / samples.spread)[stayed] ** 2).mean()))
    if registration is not None:
        known = np.diag(np.where(np.arange(len(shift)) < _AXES, registration**2, 0.0))
        return Errors(shift, np.zeros(len(shift)), known, noise, density)
    effect = samples.effect[stayed]
    # a direction of which the surface tells nothing adds nothing to what it bounds either
    inverse = np.linalg.pinv(effect.T @ effect, rcond=1e-12, hermitian=True)
    covariance: FloatArray = inverse.astype(np.float64) * density / samples.area
    return Errors(shift, shift, covariance, noise, density)


def _fit_shift(samples: Samples) -> tuple[FloatArray, BoolArray]:
    """Return the shift that the best half agrees upon, and which samples it explains."""
    change, effect = samples.change / samples.spread, samples.effect / samples.spread[:, None]
    least = _ROUNDING * float(np.ptp(change)) + np.finfo(np.float64).tiny
    shift = np.zeros(effect.shape[1])
    residual = change - np.median(change)
    scale = _TO_DEVIATION * float(np.median(np.abs(residual)))
    stayed = np.abs(residual) <= STAYED * scale + least
    for _ in range(_ROUNDS):
        shift = np.linalg.lstsq(effect[stayed], change[stayed], rcond=1e-9)[0].astype(np.float64)
        residual = np.abs(change - effect @ shift)
        scale = _TO_DEVIATION * float(np.median(residual[stayed]))
        last, stayed = stayed, residual <= STAYED * scale + least
        if np.array_equal(last, stayed):
            break
    return shift, stayed


def _sum_noise(samples: Samples, residual: FloatArray, stayed: BoolArray) -> float:
    """Return the variance of sums of residuals by area: the largest of all sizes of blocks."""
    places, residual = samples.places[stayed], residual[stayed]
    most, width = 0.0, 1.0
    while True:
        keys = pack_places(np.floor(places / width).astype(np.int64))
        _, block = np.unique(keys, return_inverse=True)
        sums = np.bincount(block, residual)
        if width > 1.0 and len(sums) < FEWEST_BLOCKS:
            return most
        most = max(most, samples.area * float((sums**2).sum()) / len(residual))
        width *= 2.0
