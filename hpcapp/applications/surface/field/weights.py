"""How much a fit believes its points, its prior and their normals, and a field its quadrics.

The constants are the method's: nobody has to set them, and all of them are here.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray
from hpccomponent.dataclass import dataclass

Variances = TypeVar("Variances", FloatArray, Float32Array)

FIELD_LEVELS = 4
"""So many levels, from the base of the lattice up, lie above the far field, and what is finer;
coarser ones only serve as priors."""

CHANCE_SHARE = 0.5
"""Of the noise's variance, what excuses that a prior misses few points: where shape is rich, the
variance is estimated too large."""

BELIEVED = 0.7
"""Of little noise, how much fits reckon with. Of 1, .7 and .5 it has the least mean distance on
scans with known truth; with .5 smooth shapes ripple (see `believe_noise`)."""

_LITTLE, _MUCH = 0.5, 0.8  # spacings: scans of much noise, told as .5 to 1, gain least by it (.98)

LEAST_MU = 0.3
"""The least weight of a prior, in points; and its weight where there is nothing to compare."""


_MOST_MU = 1000.0
_LAM_PER_NOISE = 15.0
_LEAST_LAM = 0.001
_LEAST_COARSE_LAM = 0.1  # a quadric bends within a coarse cell: its normals hold it
_MOST_LAM = 1.0

SAME_NOISE = 1.35
"""Of residuals in cells of double the size: up to this it is noise."""
_BIAS_GROWTH = 1.2
_LEAST_LOCAL, _MOST_LOCAL = 0.5, 4.0  # times the variance of the whole cloud

_FULL_COUNT = 6.0
_FULL_INHERITED = 16.0
_OWN_COUNT = 3.0
_CROWDED_FROM, _CROWDED_AT = 6.0, 12.0  # other points in the cell of a point, one level finer
_AGREES, _CONTRADICTS = 0.2, 0.6  # mean squared distances of gradients and normals
_OVERRULED_FROM, _OVERRULED_AT = 0.6, 1.2  # steps of the far field from its surface


@dataclass(frozen=True, slots=True)
class Weights:
    """The weights of one level's fits (see `hermite.fit_vertices` and `hermite.weigh_priors`).

    Normals count `least_lam` against the positions at least, dimensionless, a prior from `least_mu`
    to `most_mu` points. The `noise` is the variance of the positions along the normals, in cells of
    the level squared; a point that is `tolerance` of these off counts half (see `robust`).
    """

    least_lam: float
    noise: float
    least_mu: float
    most_mu: float
    tolerance: float = np.inf

    @property
    def lam(self) -> float:
        """The weight of the normals by the noise of the whole cloud."""
        return float(self.weigh_normals(np.array(self.noise)))

    def weigh_normals(self, noise: FloatArray) -> Float32Array:
        """Return the weights of the normals, by the variances of the positions in cells squared."""
        lam = np.minimum(np.maximum(_LAM_PER_NOISE * noise, self.least_lam), _MOST_LAM)
        result: Float32Array = lam.astype(np.float32)
        return result


def believe_noise(noise: float) -> float:
    """Tell how much of the noise fits are to reckon with, from .7 of it to all.

    `noise` is its standard deviation over the whole cloud, in spacings: .7 up to half a spacing, 1
    from .8 spacings on. Of little noise a sixth is relief that residuals cannot be told from, of
    much a sixth is missed. On 60 scans with truth the mean distance is .97 of that with all of it:
    .96 at relief, .95 at edges, 1.05 on smooth shapes. With half of it, up to .4 spacings, 40 of
    them have 1.00, .97, .94 and 1.21.
    """
    return float(np.interp(noise, (_LITTLE, _MUCH), (BELIEVED, 1.0)))


def weigh_levels(
    cell_size: float, levels: int, noise: float, tolerance: float = np.inf, base: int = 0
) -> list[Weights]:
    """Choose the weights of every level's fits, from the finest to the coarsest.

    `noise` is the standard deviation of the positions along the normals, `base` the coarsest level
    that is anywhere the finest. The coarsest level has no prior to speak of. Positions are wrong by
    the noise, normals by about the noise over the distance that they were estimated from: the
    smaller the noise is in cells, the less is to be had from normals.
    """
    weights = []
    for depth in range(levels):
        variance = (noise / (cell_size * 2.0**depth)) ** 2
        least = _LEAST_COARSE_LAM if depth > base else _LEAST_LAM
        most_mu = _MOST_MU if depth < levels - 1 else LEAST_MU
        weights.append(Weights(least, variance, LEAST_MU, most_mu, tolerance))
    return weights


def tell_noise(finer: Variances, coarser: Variances) -> Variances:
    """Tell noise from detail by the residual variances in cells of one size and of its double.

    Variances (...) are in one unit, and noise is 0 or more. It leaves the same residual in cells of
    either size; what the larger cells leave beyond that is detail that their quadrics miss, and the
    smaller ones leave a good part of it too.
    """
    bias = np.maximum(0.0, coarser - SAME_NOISE * finer) / _BIAS_GROWTH
    noise: Variances = np.maximum(0.0, finer - bias)
    return noise


def localise_noise(
    overall: FloatArray | float, finer: Float32Array, coarser: Float32Array
) -> Float32Array:
    """Tell the noise (v,) around each vertex from what the fits of coarser levels left over there.

    All are variances in cells of the vertices' level squared: that of the whole cloud, residual
    ones (v,) one and two levels further up, and the result, from half of the whole cloud's to four
    times as much.

    Scans that do not quite match leave the same residuals in cells of any size, and they are noise
    for who averages; detail that a quadric misses leaves more in larger cells, and is taken off.
    Variances of few points scatter: below half of the whole cloud's, chance is likelier than a
    better scan, and priors would be given up for nothing.
    """
    local = np.clip(tell_noise(finer, coarser), overall * _LEAST_LOCAL, overall * _MOST_LOCAL)
    result: Float32Array = local.astype(np.float32)
    return result


def find_agreement(misfits: Float32Array) -> Float32Array:
    """Tell how much of its points supports each quadric of a coarser level, from 1 down to 0, (v,).

    `misfits` (v,) tell how far it agrees with their normals (see `hermite.evaluate_misfits`). Where
    two sheets lie in one coarse cell, as at the rim of a wing, no quadric follows both. It is left
    from the field, and supports no finer one, or the surface would grow beyond the rim.
    """
    share = (_CONTRADICTS - misfits) / (_CONTRADICTS - _AGREES)
    result: Float32Array = np.clip(share, 0.0, 1.0).astype(np.float32)
    return result


def trust_vertices(
    values: Float32Array,
    far: FloatArray,
    counts: Float32Array,
    inherited: Float32Array,
    crowds: FloatArray | float,
    is_finest: BoolArray,
) -> Float32Array:
    """Tell how much the quadrics of a level count against what lies behind them, 0 to 1, (v,).

    Of the `values` (v,) of quadrics at their own vertices only the sign counts; `far` (v,) is the
    far field there, in its steps, positive outside. `counts` and `inherited` (v,) are as of
    `VertexQuadrics`; `crowds`, one or (v,), as of `crowd_vertices`: other points in the cell of a
    point of the next finer level, 0 where none is finer; `is_finest` (v,) tells where no finer
    quadrics are.

    Quadrics go on where the surface ends, and sheets would grow there. Where the far field is sure
    of its sign and the quadric has the other one, it is overruled, unless points of its own support
    it. Where there are finer ones points support it only as a whole, from all around.

    Coarse quadrics fill in where finer cells hold too few points; where these hold enough, the
    space between them is empty because the surface does not pass there.
    """
    # (v,): by the points around, as far as finer cells do not hold enough of them already.
    trust = np.minimum(1.0, counts / _FULL_COUNT + inherited / _FULL_INHERITED)
    trust *= np.clip((_CROWDED_AT - crowds) / (_CROWDED_AT - _CROWDED_FROM), 0.0, 1.0)
    # (v,): how far the far field overrules a quadric of the other sign, unless points support it.
    sure = (np.abs(far) - _OVERRULED_FROM) / (_OVERRULED_AT - _OVERRULED_FROM)
    overruled = np.clip(sure, 0.0, 1.0) * (np.sign(values) != np.sign(far))
    own = np.where(is_finest, np.clip(counts / _OWN_COUNT, 0.0, 1.0), 0.0)
    result: Float32Array = (trust * (1.0 - overruled * (1.0 - own))).astype(np.float32)
    return result
