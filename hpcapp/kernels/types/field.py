"""The implicit function as values: levels of quadrics, and the far field behind them."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from hpcapp.geometry.points import ByteArray, Float32Array, FloatArray, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record

CHANNELS = 12
"""Ten coefficients, presence and trust of a vertex."""


PIECES = 3
"""Quadrics of a vertex at an edge or a corner."""


@record("surface.field_level")
@dataclass(frozen=True, slots=True, eq=False)
class FieldLevel:
    """The quadrics of one lattice, at its vertices of sorted keys (v,), in cells of it.

    The `trust` (v,) is what each counts against the levels behind and the far field, 0 to 1.
    """

    keys: IntArray
    coefficients: Float32Array
    trust: Float32Array

    def channels(self) -> FloatArray:
        """Return coefficients, 1 and trust, shape (12, v + 1).

        The last column, all zero, stands for a vertex that is missing.
        """
        channels = np.zeros((CHANNELS, len(self.keys) + 1))
        channels[:10, :-1] = self.coefficients.T
        channels[10, :-1] = 1.0
        channels[11, :-1] = self.trust
        return channels


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Those vertices of a lattice around which the surface has an edge or a corner.

    Parameters
    ----------
    keys : ndarray of int64, shape (k,)
        Sorted, each a vertex of the lattice.
    pieces : ndarray of float32, shape (k, 3, 10)
        The quadrics of the smooth pieces, in cells; of an edge, the second one stands twice.
    joints : ndarray of uint8, shape (k,)
        How they are joined: f = outer(p0, inner(p1, p2)). Bit 0: outer is min, else max; bit 1:
        inner is min, else max. Of convex edges it is max, positive values lie outside.
    """

    keys: IntArray
    pieces: Float32Array
    joints: ByteArray


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """All that the implicit function is made of.

    Corner (0, 0, 0) of every lattice lies at `origin` (3,); the finest has cells of `cell_size`, in
    length units of the input. The levels come finest first, each with cells twice as large as those
    of the one before; the features are of the first levels: vertices whose joined quadrics take the
    place of their own one.
    """

    origin: FloatArray
    cell_size: float
    levels: tuple[FieldLevel, ...]
    far: FarField
    features: tuple[Features, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class FarField:
    """Signed distances on a coarse cubic grid.

    Parameters
    ----------
    values : ndarray of float32, shape (g, g, g)
        In length units of the input, positive outside, at most 1.5 steps large; 0 far from the
        box that the field was asked to cover.
    origin : ndarray of float64, shape (3,)
        Where node (0, 0, 0) lies.
    step : float
        Distance of neighbouring nodes, in length units of the input.
    hull : ndarray of float64, shape (k, 4)
        Planes beyond which all is outside, whatever the levels say: unit normals, then distances
        from the frame's origin, in length units of the input.
    """

    values: Float32Array
    origin: FloatArray
    step: float
    hull: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
