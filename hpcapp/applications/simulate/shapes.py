"""Analytic models with known truth: value, normal, genus and bounding box.

Every shape in `SHAPES` is one closed surface. Sizes and positions differ on purpose: nothing
that reads points may assume a unit box.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np

from hpcapp.applications.simulate import solids
from hpcapp.applications.simulate.solids import Field
from hpccomponent.errors import UsageError
from hpccomponent.surface.types.points import FloatArray

__all__ = ["SHAPES", "ImplicitShape", "Shape", "diagonal_of", "find_shape"]

Bounds = tuple[FloatArray, FloatArray]


class Shape(Protocol):
    """A solid whose surface is the zero set of a function that is known exactly."""

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
        """Return the implicit function: negative inside, never larger than the distance.

        Parameters
        ----------
        points : ndarray of float64, shape (n, 3)

        Returns
        -------
        ndarray of float64, shape (n,)
            In length units.
        """
        ...

    def normal(self, points: FloatArray) -> FloatArray:
        """Return the unit normals, pointing out of the solid, of the level sets at `points`.

        Parameters
        ----------
        points : ndarray of float64, shape (n, 3)

        Returns
        -------
        ndarray of float64, shape (n, 3)
            On a sharp edge, that of one of its sides.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ImplicitShape:
    """A `Shape` made of a field.

    Parameters
    ----------
    name : str
    genus : int
    bounds : (low, high), each ndarray of float64, shape (3,)
    field : Field
        See `hpcapp.applications.simulate.solids`.
    """

    name: str
    genus: int
    bounds: Bounds
    field: Field

    def value(self, points: FloatArray) -> FloatArray:
        """Return the implicit function at `points`; see `Shape.value`.

        Parameters
        ----------
        points : ndarray of float64, shape (n, 3)

        Returns
        -------
        ndarray of float64, shape (n,)
            In length units.
        """
        return self.field(points)[0]

    def normal(self, points: FloatArray) -> FloatArray:
        """Return the unit normals at `points`; see `Shape.normal`.

        Parameters
        ----------
        points : ndarray of float64, shape (n, 3)

        Returns
        -------
        ndarray of float64, shape (n, 3)
            Zero where the field has no gradient.
        """
        gradient = self.field(points)[1]
        length = np.sqrt(np.einsum("ij,ij->i", gradient, gradient))
        unit: FloatArray = gradient / np.maximum(length, np.finfo(np.float64).tiny)[:, None]
        return unit


def diagonal_of(shape: Shape) -> float:
    """Return the length of the bounding box's diagonal, in length units of the shape.

    Parameters
    ----------
    shape : Shape

    Returns
    -------
    float
    """
    low, high = shape.bounds
    return float(np.linalg.norm(high - low))


def find_shape(name: str) -> Shape:
    """Return the shape of that name.

    Parameters
    ----------
    name : str
        A key of `SHAPES`.

    Returns
    -------
    Shape

    Raises
    ------
    UsageError
        If there is none.

    Examples
    --------
    >>> find_shape("torus").genus
    1
    """
    if name not in SHAPES:
        known = ", ".join(SHAPES)
        raise UsageError(f"there is no shape named {name!r}", f"choose one of {known}")
    return SHAPES[name]


def _symmetric(*half: float) -> Bounds:
    """Return the bounds of a shape about the origin, from half its edges."""
    extent = np.array(half)
    return -extent, extent


def _trefoil(t: FloatArray) -> FloatArray:
    """Return a trefoil on a torus of radii 10 and 4.5, and its two derivatives by t."""
    major, minor = 10.0, 4.5
    radius = major + minor * np.cos(3 * t)
    radius_1, radius_2 = -3 * minor * np.sin(3 * t), -9 * minor * np.cos(3 * t)
    cos, sin = np.cos(2 * t), np.sin(2 * t)
    zero = [radius * cos, radius * sin, minor * np.sin(3 * t)]
    first = [
        radius_1 * cos - 2 * radius * sin,
        radius_1 * sin + 2 * radius * cos,
        3 * minor * np.cos(3 * t),
    ]
    second = [
        radius_2 * cos - 4 * radius_1 * sin - 4 * radius * cos,
        radius_2 * sin + 4 * radius_1 * cos - 4 * radius * sin,
        -9 * minor * np.sin(3 * t),
    ]
    return np.array([zero, first, second]).transpose(0, 2, 1)


def _knot() -> ImplicitShape:
    """Return a tube of radius 2 about the trefoil; its extent is the curve's plus its radius."""
    curve = _trefoil(np.linspace(0.0, 2.0 * np.pi, 200_000))[0]
    bounds = (curve.min(axis=0) - 2.0, curve.max(axis=0) + 2.0)
    return ImplicitShape("knot", 1, bounds, solids.tube(_trefoil, 2.0))


def _bracket() -> ImplicitShape:
    """Return an angle bracket with sharp edges, four drilled holes and a blind one: genus 4."""
    base = solids.box((0.0, 0.0, 4.0), (60.0, 35.0, 4.0))
    upright = solids.box((-55.0, 0.0, 35.0), (5.0, 35.0, 35.0))
    body = solids.unite(base, upright)
    holes = [
        solids.cylinder((40.0, 20.0, 4.0), 2, 5.0, 10.0),
        solids.cylinder((40.0, -20.0, 4.0), 2, 5.0, 10.0),
        solids.cylinder((0.0, 0.0, 4.0), 2, 14.0, 10.0),
        solids.cylinder((-55.0, 0.0, 42.0), 0, 12.0, 10.0),
    ]
    blind = solids.cylinder((40.0, 0.0, 8.0), 2, 6.0, 4.0)
    bounds = (np.array([-60.0, -35.0, 0.0]), np.array([60.0, 35.0, 70.0]))
    return ImplicitShape("bracket", 4, bounds, solids.cut(body, *holes, blind))


def _plate() -> ImplicitShape:
    """Return a box whose two sheets are one per cent of the diagonal apart."""
    half = (1.0, 0.7, 0.0122)
    return ImplicitShape("plate", 0, _symmetric(*half), solids.box((0.0, 0.0, 0.0), half))


def _plates() -> ImplicitShape:
    """Return two thin sheets one per cent of the diagonal apart, joined along one short side.

    The joint makes them one surface, so that the number of pieces is beyond dispute.
    """
    gap, sheet = 0.0122, 0.017
    block = solids.box((0.0, 0.0, 0.0), (1.0, 0.7, gap + 2 * sheet))
    slot = solids.box((0.1, 0.0, 0.0), (1.05, 0.8, gap))
    bounds = _symmetric(1.0, 0.7, gap + 2 * sheet)
    return ImplicitShape("plates", 0, bounds, solids.cut(block, slot))


def _fingers() -> ImplicitShape:
    """Return a hand with five limbs of unlike thickness, from 6 to 1.6 % of the diagonal."""
    limbs = [
        ((0.0, 0.0, 0.0), (0.0, 80.0, 0.0), 30.0, 34.0),
        ((-30.0, 84.0, 0.0), (-64.0, 182.0, 14.0), 9.0, 5.5),
        ((-8.0, 94.0, 0.0), (-20.0, 208.0, 4.0), 8.0, 4.0),
        ((14.0, 94.0, 0.0), (26.0, 200.0, -6.0), 6.0, 3.0),
        ((32.0, 82.0, 0.0), (68.0, 164.0, -18.0), 5.0, 2.5),
        ((26.0, 30.0, 6.0), (92.0, 86.0, 34.0), 12.0, 7.0),
    ]
    tips = np.array([[*end, radius] for start, end, first, radius in limbs])
    wrist = np.array([0.0, 0.0, 0.0, 30.0])
    balls = np.concatenate([tips, wrist[None]])
    low = (balls[:, :3] - balls[:, 3:]).min(axis=0)
    high = (balls[:, :3] + balls[:, 3:]).max(axis=0)
    field = solids.smooth_unite(8.0, *(solids.cone(*limb) for limb in limbs))
    return ImplicitShape("fingers", 0, (low, high), field)


def _frame() -> ImplicitShape:
    """Return the twelve edges of a cube as tubes with filleted corners: 12 - 8 + 1 handles."""
    ends = ((0.0, 1.0, 1.0), (1.0, 0.0, 1.0), (1.0, 1.0, 0.0))
    edges = [solids.cone((1.0, 1.0, 1.0), end, 0.12, 0.12) for end in ends]
    corner = solids.mirror(solids.smooth_unite(0.1, *edges))
    # Two fillets, each up to a sixth of 0.1 and the second less by their overlap, swell a corner.
    extent = 1.12 + 0.0263
    return ImplicitShape("frame", 5, _symmetric(extent, extent, extent), corner)


def _shaft() -> ImplicitShape:
    """Return a stepped shaft along x, 2.6 % of the diagonal thick between its two collars."""
    field = solids.unite(
        solids.cylinder((0.0, 0.0, 0.0), 0, 0.04, 1.5),
        solids.cylinder((-0.9, 0.0, 0.0), 0, 0.2, 0.12),
        solids.cylinder((0.6, 0.0, 0.0), 0, 0.12, 0.3),
    )
    return ImplicitShape("shaft", 0, _symmetric(1.5, 0.2, 0.2), field)


def _rounded_box() -> ImplicitShape:
    """Return a box with rounded edges."""
    core = solids.box((0.0, 0.0, 0.0), (0.8, 0.5, 0.3))
    return ImplicitShape("box", 0, _symmetric(0.9, 0.6, 0.4), solids.grow(core, 0.1))


def _catalogue() -> tuple[ImplicitShape, ...]:
    """Return every shape, the simple ones first."""
    return (
        ImplicitShape("sphere", 0, _symmetric(1.0, 1.0, 1.0), solids.ellipsoid((1.0, 1.0, 1.0))),
        ImplicitShape("ellipsoid", 0, _symmetric(5.0, 3.0, 2.0), solids.ellipsoid((5.0, 3.0, 2.0))),
        ImplicitShape("torus", 1, _symmetric(1.35, 1.35, 0.35), solids.torus(1.0, 0.35)),
        ImplicitShape("ring", 1, _symmetric(1.03, 1.03, 0.03), solids.torus(1.0, 0.03)),
        _knot(),
        _rounded_box(),
        _bracket(),
        _plate(),
        _plates(),
        _fingers(),
        _frame(),
        _shaft(),
    )


SHAPES: Mapping[str, Shape] = MappingProxyType({shape.name: shape for shape in _catalogue()})
