"""What an analytic model tells of itself: value, normal, genus and bounding box."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.lab.simulate.fields import SolidField
from hpccomponent.dataclass import dataclass

Bounds = tuple[FloatArray, FloatArray]


class Solid(Protocol):
    """A solid whose surface is the zero set of a function that is known exactly.

    Methods take positions of shape (n, 3); values, of shape (n,), are in length units.
    """

    @property
    def name(self) -> str:
        """Return the name by which users call it."""
        ...

    @property
    def genus(self) -> int:
        """Return the number of handles of its one surface."""
        ...

    @property
    def bounds(self) -> Bounds:
        """Return the smallest and largest coordinates of its surface, each of shape (3,)."""
        ...

    def value(self, points: FloatArray) -> FloatArray:
        """Return the implicit function: negative inside, never larger than the distance."""
        ...

    def normal(self, points: FloatArray) -> FloatArray:
        """Return the unit normals, pointing out of the solid, of the level sets at `points`.

        On a sharp edge, that of one of its sides.
        """
        ...

    def gradient(self, points: FloatArray) -> FloatArray:
        """Return the gradient of `value`, no longer than 1; zero where the function has none."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ImplicitShape:
    """A `Solid` made of a field."""

    name: str
    genus: int
    bounds: Bounds
    field: SolidField

    def value(self, points: FloatArray) -> FloatArray:
        """Return the implicit function at `points`."""
        return self.field.value(points)

    def gradient(self, points: FloatArray) -> FloatArray:
        """Return the gradient at `points`."""
        return self.field.gradient(points)

    def normal(self, points: FloatArray) -> FloatArray:
        """Return the unit normals at `points`; zero where the field has no gradient."""
        gradient = self.field.gradient(points)
        length = np.sqrt(np.einsum("ij,ij->i", gradient, gradient))
        unit: FloatArray = gradient / np.maximum(length, np.finfo(np.float64).tiny)[:, None]
        return unit


def diagonal_of(shape: Solid) -> float:
    """Return the length of the bounding box's diagonal, in length units of the shape."""
    low, high = shape.bounds
    return float(np.linalg.norm(high - low))


def symmetric(*half: float) -> Bounds:
    """Return the bounds of a shape about the origin, from half the edges of its bounding box."""
    extent = np.array(half)
    return -extent, extent
