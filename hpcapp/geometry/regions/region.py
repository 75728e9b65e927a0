"""The part of a scan that a user asks for: a box, or a ball."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from hpcapp.geometry.points import BoolArray, FloatArray
from hpcapp.geometry.regions.clipping import CutPiece, Cutter, clip_ball, clip_box
from hpcapp.geometry.regions.splitting import refine_at_sphere
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record


class Area(Cutter, Protocol):
    """A part of space that a user asks for, in the coordinates of the points."""

    @property
    def longest(self) -> float:
        """How large it is, in the unit of x and y: margins are shares of it."""
        ...

    @property
    def on_the_wire(self) -> Region | None:
        """What workers are told of it, where they can find its points themselves."""
        ...

    def find(self, positions: FloatArray) -> BoolArray:
        """Tell which points of shape (n, 3) lie in it, its border included; NaN never does."""
        ...

    def meets(self, lows: FloatArray, highs: FloatArray) -> BoolArray:
        """Tell which boxes, by corners of shape (n, 3), may have a part in it."""
        ...

    def widen(self, margin: float) -> Area:
        """Return what lies within a margin of it, in the unit of x and y."""
        ...

    def localise(self, origin: FloatArray) -> Area:
        """Return it in a local frame in which z has the unit of x and y, as `origin` has."""
        ...


@record("surface.region")
@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """What of a box lies within a radius of a place.

    Parameters
    ----------
    low, high : ndarray of float64, shape (3,)
        Corners of the box, in the coordinates of the points.
    radius : float
        In the unit of x and y, of the centre (3,); infinite where all of the box is meant.
    height_unit : float
        How long a unit of z is, in units of x and y.
    """

    low: FloatArray
    high: FloatArray
    centre: FloatArray
    radius: float
    height_unit: float = 1.0

    @classmethod
    def box(cls, one: FloatArray, other: FloatArray, height_unit: float = 1.0) -> Region:
        """Return the box between two corners."""
        low, high = np.minimum(one, other), np.maximum(one, other)
        return cls(low, high, low / 2 + high / 2, np.inf, height_unit)

    @classmethod
    def ball(cls, centre: FloatArray, radius: float, height_unit: float = 1.0) -> Region:
        """Return the ball around a place."""
        reach = radius / np.array([1.0, 1.0, height_unit])
        return cls(centre - reach, centre + reach, centre, radius, height_unit)

    @property
    def scales(self) -> FloatArray:
        """What makes coordinates as long as x and y, shape (3,)."""
        return np.array([1.0, 1.0, self.height_unit])

    @property
    def longest(self) -> float:
        """Its longest side, in the unit of x and y."""
        return float(((self.high - self.low) * self.scales).max())

    def find(self, positions: FloatArray) -> BoolArray:
        """Tell which points of shape (n, 3) lie in it, its border included; NaN never does."""
        # Column by column: reductions along rows of three are several times slower.
        columns = zip(positions.T, self.low, self.high, strict=True)
        inside: BoolArray = np.logical_and.reduce(
            [(column >= low) & (column <= high) for column, low, high in columns]
        )
        if self.radius < np.inf:
            inside &= self.beyond(positions) <= 0.0
        return inside

    def meets(self, lows: FloatArray, highs: FloatArray) -> BoolArray:
        """Tell which boxes, by corners of shape (n, 3), may have a part in it."""
        meets: BoolArray = np.all((lows <= self.high) & (highs >= self.low), axis=1)
        return meets

    def cut(self, piece: CutPiece) -> CutPiece:
        """Return what of a mesh, in its frame with z in the unit of x and y, lies in it."""
        if self.radius < np.inf:
            fine = refine_at_sphere(piece, self.centre, self.radius)
            return clip_ball(fine, self.centre, self.radius)
        return clip_box(piece, self.low, self.high)

    @property
    def on_the_wire(self) -> Region | None:
        """What workers are told of it: all."""
        return self

    def beyond(self, positions: FloatArray) -> FloatArray:
        """Return how far beyond the radius points are, shape (n,); negative within."""
        arms = ((positions - self.centre) * self.scales).T
        beyond: FloatArray = np.sqrt(sum(arm * arm for arm in arms)) - self.radius
        return beyond

    def widen(self, margin: float) -> Region:
        """Return what lies within a margin of it, in the unit of x and y, corners included."""
        more = margin / self.scales
        return replace(
            self, low=self.low - more, high=self.high + more, radius=self.radius + margin
        )

    def localise(self, origin: FloatArray) -> Region:
        """Return it in a local frame in which z has the unit of x and y, as `origin` has."""
        scales = self.scales
        low, high, centre = (
            place * scales - origin for place in (self.low, self.high, self.centre)
        )
        return replace(self, low=low, high=high, centre=centre, height_unit=1.0)

    def __str__(self) -> str:
        if self.radius < np.inf:
            return f"the ball of {self.radius:.9g} around {say_place(self.centre)}"
        return f"the box from {say_place(self.low)} to {say_place(self.high)}"


def say_place(place: FloatArray) -> str:
    """Return coordinates as people write them."""
    return " ".join(f"{value:.9g}" for value in place)
