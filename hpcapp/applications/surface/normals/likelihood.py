"""How probable a reading is, by what it costs and what else speaks for it: one fit.

A power of its cost gives the odds of a reading, as the evidence adds up over an area whose parts
are not independent. How common such scans are multiplies them; so does each of three pieces of
evidence. The numbers are the maximum of the likelihood of the true sides of scans whose truth is
known, by `benchmarks/readings.py`, which shows on others how often is right what is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass

FLOOR = 0.005
"""Least cost: the share of the area that edges and noise show from behind where all is right."""
UPS = (2, 1.0), (1, 1.0), (1, -1.0)
"""Axes that may point up, and their signs: z of maps, y of many programs, -y of cameras."""


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """What counts for a reading.

    Parameters
    ----------
    kind : str
        See `Hypothesis`.
    cost : float
        Share of the area that was seen from behind, or not at all.
    evenness : float
        How much more evenly points lie as seen from the sensor than on the surface: a logarithm.
    facing : ndarray of float64, shape (3,)
        Of what lies level along each axis, how much more faces along it than against it, as a
        share of the area.
    """

    kind: str
    cost: float = 0.0
    evenness: float = 0.0
    facing: FloatArray | None = None

    def with_sides(self, cost: float, facing: FloatArray) -> Features:
        """Return the same with what depends on the sides."""
        return replace(self, cost=cost, facing=facing)


@dataclass(frozen=True, slots=True)
class Likelihood:
    """The numbers of the fit, as logarithms of odds.

    Parameters
    ----------
    power : float
        Of the cost.
    around, inside, amid, side, sensor, flown, places : float
        How much more common such scans are than those from all around; of what the file tells,
        how far it is believed.
    among, evenness : float
        What points that lie evenly as seen from places among them, or from a sensor whose place is
        given, speak for these.
    facing : float
        What all that lies level says when it faces up.
    z_up, y_up, y_down : float
        How common it is that an axis points up, beside none of them.
    held, tangle : float
        How seldom links are wrong, as no reading can tell, and by how much more often where the
        sides of one break all the links.
    """

    power: float
    around: float
    inside: float
    amid: float
    sensor: float
    flown: float
    places: float
    side: float
    among: float
    evenness: float
    facing: float
    z_up: float
    y_up: float
    y_down: float
    held: float
    tangle: float

    def odds(self, features: Features) -> float:
        """Return the logarithm of the odds of a reading, up to what all have in common."""
        common = 0.0 if features.kind == "outside" else getattr(self, features.kind)
        weight = self.among if features.kind in ("inside", "amid") else self.evenness
        told = weight * features.evenness
        level = float(np.logaddexp.reduce([0.0, *self.ups(features)]))
        return float(common + told + level - self.power * np.log(FLOOR + features.cost))

    def ups(self, features: Features) -> list[float]:
        """Return the logarithms of the odds that each of `UPS` points up, beside none of them."""
        facing = np.zeros(3) if features.facing is None else features.facing
        commons = self.z_up, self.y_up, self.y_down
        return [
            common + self.facing * sign * float(facing[axis])
            for common, (axis, sign) in zip(commons, UPS, strict=True)
        ]

    def find_shares(self, features: Sequence[Features], broken: float) -> FloatArray:
        """Return the probabilities of readings; what they lack to 1 is that none is true.

        Parameters
        ----------
        features : sequence of Features
        broken : float
            Share of the links that sides break.
        """
        odds = np.array([self.odds(one) for one in features])
        shares = np.exp(odds - odds.max())
        held = 1.0 / (1.0 + np.exp(self.tangle * broken - self.held))
        found: FloatArray = held * shares / shares.sum()
        return found


FITTED = Likelihood(
    power=2.39, around=-1.36, inside=-5.23, amid=-2.68, sensor=-3.05, flown=4.9, places=4.46,
    side=-2.23, among=5.45, evenness=8.28, facing=2.57, z_up=1.19, y_up=-1.6, y_down=1.2,
    held=4.63, tangle=44.6,
)  # fmt: skip
