"""Machine parts with sharp edges, straight and curved, corners, through holes and thin fins."""

from __future__ import annotations

import numpy as np

from hpcapp.lab.simulate import outlines, solids
from hpcapp.lab.simulate.fields import cut, intersect
from hpcapp.lab.simulate.implicit import ImplicitShape, symmetric


def _gear() -> ImplicitShape:
    """Return a gear of 14 teeth with a bore and six holes in its web: seven through holes."""
    teeth, root, tip = 14, 40.0, 50.0
    pitch = 2.0 * np.pi / teeth
    flank = [(root, -0.30), (tip, -0.15), (tip, 0.15), (root, 0.30)]  # radius, turn in pitches
    corners = [
        (radius * np.cos(pitch * (tooth + turn)), radius * np.sin(pitch * (tooth + turn)))
        for tooth in range(teeth)
        for radius, turn in flank
    ]
    holes = [
        outlines.disc((26.0 * np.cos(turn), 26.0 * np.sin(turn)), 7.0)
        for turn in 2.0 * np.pi / 6 * (np.arange(6) + 0.25)
    ]
    outline = cut(outlines.polygon(corners), outlines.disc((0.0, 0.0), 11.0), *holes)
    extent = np.abs(corners).max(axis=0)
    return ImplicitShape("gear", 7, symmetric(*extent, 8.0), outlines.extrude(outline, 8.0))


def _heatsink() -> ImplicitShape:
    """Return a heat sink: nine fins, 1.3 % of the diagonal thick, and two bores along its base."""
    pitch, fin, base, top, fins = 10.0, 1.6, 10.0, 45.0, 9
    half = 0.5 * ((fins - 1) * pitch + fin)
    corners = [(-half, 0.0), (half, 0.0)]
    for number in reversed(range(fins)):
        left = -half + number * pitch
        corners += [(left + fin, top), (left, top)]
        if number:
            corners += [(left, base), (left - pitch + fin, base)]
    bores = [outlines.disc((x, 5.0), 2.5) for x in (-25.0, 25.0)]
    outline = cut(outlines.polygon(corners), *bores)
    bounds = (np.array([-half, 0.0, -40.0]), np.array([half, top, 40.0]))
    return ImplicitShape("heatsink", 2, bounds, outlines.extrude(outline, 40.0))


def _flange() -> ImplicitShape:
    """Return a pipe flange: turned, with a conical hub, a groove and eight bolt holes."""
    profile = [
        (20.0, 0.0), (60.0, 0.0), (60.0, 12.0), (44.0, 12.0), (44.0, 9.0), (40.0, 9.0),
        (40.0, 12.0), (34.0, 12.0), (26.0, 36.0), (20.0, 36.0),
    ]  # fmt: skip
    turned = outlines.revolve(outlines.polygon(profile))
    turns = 2.0 * np.pi / 8 * np.arange(8)
    bolts = [
        solids.cylinder((52.0 * np.cos(turn), 52.0 * np.sin(turn), 6.0), 2, 4.0, 10.0)
        for turn in turns
    ]
    bounds = (np.array([-60.0, -60.0, 0.0]), np.array([60.0, 60.0, 36.0]))
    return ImplicitShape("flange", 9, bounds, cut(turned, *bolts))


def _manifold() -> ImplicitShape:
    """Return a block with oblique chamfers and three bores that cross in its middle: genus 5."""
    half = (30.0, 24.0, 20.0)
    chamfers = [
        solids.half_space((1.0, 1.0, 0.0), 32.0),
        solids.half_space((-1.0, 0.4, 0.6), 30.0),
        solids.half_space((0.0, -1.0, 1.5), 25.0),
    ]
    block = intersect(solids.box((0.0, 0.0, 0.0), half), *chamfers)
    bores = [
        solids.cylinder((0.0, 0.0, 0.0), axis, radius)
        for axis, radius in enumerate((9.0, 7.0, 5.0))
    ]
    return ImplicitShape("manifold", 5, symmetric(*half), cut(block, *bores))


PARTS: tuple[ImplicitShape, ...] = (_gear(), _heatsink(), _flange(), _manifold())
