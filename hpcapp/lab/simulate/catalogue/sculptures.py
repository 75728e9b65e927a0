"""Models with relief: detail of several sizes on a smooth body, as statues have it.

Their bounds were found by sampling, and are a thousandth of the diagonal wide of it.
"""

from __future__ import annotations

import numpy as np

from hpcapp.lab.simulate import solids
from hpcapp.lab.simulate.fields import smooth_unite
from hpcapp.lab.simulate.implicit import ImplicitShape, symmetric
from hpcapp.lab.simulate.reliefs import displace, lumps, studs


def _boulder() -> ImplicitShape:
    """Return a ball with lumps of five sizes, from 25 to 1.6 % of the diagonal."""
    ball = solids.ellipsoid((1.0, 1.0, 1.0))
    octaves = [(0.9, 0.07), (0.42, 0.025), (0.2, 0.01), (0.1, 0.004), (0.056, 0.0018)]
    bounds = (np.array([-1.048, -1.045, -1.03]), np.array([1.027, 1.03, 1.042]))
    return ImplicitShape("boulder", 0, bounds, displace(ball, lumps(octaves, 7)))


def _studded() -> ImplicitShape:
    """Return a torus with rows of studs and pits."""
    body = displace(solids.torus(1.0, 0.4), studs(1.0, 0.4, (40, 16), 0.01))
    return ImplicitShape("studded", 1, symmetric(1.41, 1.41, 0.41), body)


def _bust() -> ImplicitShape:
    """Return a bust on a round base, with features and a fine texture."""
    body = smooth_unite(
        14.0,
        solids.ellipsoid((64.0, 56.0, 26.0), (0.0, 0.0, 26.0)),
        solids.ellipsoid((78.0, 40.0, 46.0), (0.0, 0.0, 88.0)),
        solids.cone((0.0, 4.0, 110.0), (0.0, -2.0, 160.0), 26.0, 22.0),
        solids.ellipsoid((36.0, 44.0, 50.0), (0.0, -6.0, 190.0)),
        solids.cone((0.0, -50.0, 194.0), (0.0, -58.0, 178.0), 4.0, 7.0),
        solids.cone((-38.0, -2.0, 194.0), (-40.0, 2.0, 180.0), 7.0, 5.0),
        solids.cone((38.0, -2.0, 194.0), (40.0, 2.0, 180.0), 7.0, 5.0),
    )
    octaves = [(40.0, 2.0), (17.0, 0.8), (8.0, 0.3)]
    bounds = (np.array([-79.4, -67.4, -2.6]), np.array([81.6, 60.0, 243.0]))
    return ImplicitShape("bust", 0, bounds, displace(body, lumps(octaves, 3)))


SCULPTURES: tuple[ImplicitShape, ...] = (_boulder(), _studded(), _bust())
