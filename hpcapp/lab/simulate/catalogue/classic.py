"""Models with smooth surfaces, thin limbs or sharp edges, which every method is tested on first."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.lab.simulate import solids
from hpcapp.lab.simulate.fields import cut, grow, mirror, smooth_unite, unite
from hpcapp.lab.simulate.implicit import ImplicitShape, symmetric


def _trefoil(t: FloatArray) -> FloatArray:
    """Return a trefoil on a torus of radii 10 and 4.5, and its two derivatives: see `tube`."""
    major, minor = 10.0, 4.5
    c, s = np.cos(t), np.sin(t)
    cos, sin = c * c - s * s, 2.0 * c * s  # of 2 t
    out, up = minor * c * (c * c - 3.0 * s * s), minor * s * (3.0 * c * c - s * s)  # by 3 t
    radius, radius_1, radius_2 = major + out, -3.0 * up, -9.0 * out
    zero = [radius * cos, radius * sin, up]
    first = [
        radius_1 * cos - 2.0 * radius * sin,
        radius_1 * sin + 2.0 * radius * cos,
        3.0 * out,
    ]
    second = [
        radius_2 * cos - 4.0 * radius_1 * sin - 4.0 * radius * cos,
        radius_2 * sin + 4.0 * radius_1 * cos - 4.0 * radius * sin,
        -9.0 * up,
    ]
    return np.array([zero, first, second])


def _knot() -> ImplicitShape:
    """Return a tube of radius 2 about the trefoil; its extent is the curve's plus its radius."""
    curve = _trefoil(np.linspace(0.0, 2.0 * np.pi, 200_000))[0]
    bounds = (curve.min(axis=1) - 2.0, curve.max(axis=1) + 2.0)
    return ImplicitShape("knot", 1, bounds, solids.tube(_trefoil, 2.0))


def _bracket() -> ImplicitShape:
    """Return an angle bracket with sharp edges, four drilled holes and a blind one: genus 4."""
    base = solids.box((0.0, 0.0, 4.0), (60.0, 35.0, 4.0))
    upright = solids.box((-55.0, 0.0, 35.0), (5.0, 35.0, 35.0))
    body = unite(base, upright)
    holes = [
        solids.cylinder((40.0, 20.0, 4.0), 2, 5.0, 10.0),
        solids.cylinder((40.0, -20.0, 4.0), 2, 5.0, 10.0),
        solids.cylinder((0.0, 0.0, 4.0), 2, 14.0, 10.0),
        solids.cylinder((-55.0, 0.0, 42.0), 0, 12.0, 10.0),
    ]
    blind = solids.cylinder((40.0, 0.0, 8.0), 2, 6.0, 4.0)
    bounds = (np.array([-60.0, -35.0, 0.0]), np.array([60.0, 35.0, 70.0]))
    return ImplicitShape("bracket", 4, bounds, cut(body, *holes, blind))


def _plate() -> ImplicitShape:
    """Return a box whose two sheets are one per cent of the diagonal apart."""
    half = (1.0, 0.7, 0.0122)
    return ImplicitShape("plate", 0, symmetric(*half), solids.box((0.0, 0.0, 0.0), half))


def _plates() -> ImplicitShape:
    """Return two thin sheets one per cent of the diagonal apart, joined along one short side.

    The joint makes them one surface, so that the number of pieces is beyond dispute.
    """
    gap, sheet = 0.0122, 0.017
    block = solids.box((0.0, 0.0, 0.0), (1.0, 0.7, gap + 2 * sheet))
    slot = solids.box((0.1, 0.0, 0.0), (1.05, 0.8, gap))
    bounds = symmetric(1.0, 0.7, gap + 2 * sheet)
    return ImplicitShape("plates", 0, bounds, cut(block, slot))


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
    field = smooth_unite(8.0, *(solids.cone(*limb) for limb in limbs))
    return ImplicitShape("fingers", 0, (low, high), field)


def _frame() -> ImplicitShape:
    """Return the twelve edges of a cube as tubes with filleted corners: 12 - 8 + 1 handles."""
    ends = ((0.0, 1.0, 1.0), (1.0, 0.0, 1.0), (1.0, 1.0, 0.0))
    edges = [solids.cone((1.0, 1.0, 1.0), end, 0.12, 0.12) for end in ends]
    corner = mirror(smooth_unite(0.1, *edges))
    # Two fillets, each up to a sixth of 0.1 and the second less by their overlap, swell a corner.
    extent = 1.12 + 0.0263
    return ImplicitShape("frame", 5, symmetric(extent, extent, extent), corner)


def _shaft() -> ImplicitShape:
    """Return a stepped shaft along x, 2.6 % of the diagonal thick between its two collars."""
    field = unite(
        solids.cylinder((0.0, 0.0, 0.0), 0, 0.04, 1.5),
        solids.cylinder((-0.9, 0.0, 0.0), 0, 0.2, 0.12),
        solids.cylinder((0.6, 0.0, 0.0), 0, 0.12, 0.3),
    )
    return ImplicitShape("shaft", 0, symmetric(1.5, 0.2, 0.2), field)


def _rounded_box() -> ImplicitShape:
    """Return a box with rounded edges."""
    core = solids.box((0.0, 0.0, 0.0), (0.8, 0.5, 0.3))
    return ImplicitShape("box", 0, symmetric(0.9, 0.6, 0.4), grow(core, 0.1))


CLASSIC: tuple[ImplicitShape, ...] = (
    ImplicitShape("sphere", 0, symmetric(1.0, 1.0, 1.0), solids.ellipsoid((1.0, 1.0, 1.0))),
    ImplicitShape("ellipsoid", 0, symmetric(5.0, 3.0, 2.0), solids.ellipsoid((5.0, 3.0, 2.0))),
    ImplicitShape("torus", 1, symmetric(1.35, 1.35, 0.35), solids.torus(1.0, 0.35)),
    ImplicitShape("ring", 1, symmetric(1.03, 1.03, 0.03), solids.torus(1.0, 0.03)),
    _knot(),
    _rounded_box(),
    _bracket(),
    _plate(),
    _plates(),
    _fingers(),
    _frame(),
    _shaft(),
)
