"""How probable a reading is, by what it costs and what else speaks for it: one fit.

A power of its cost gives the odds of a reading, as the evidence adds up over an area whose parts
are not independent. How common such scans are multiplies them; so does each of three pieces of
evidence. The numbers are the maximum of the likelihood of the true sides of scans whose truth is
known, by `benchmarks/readings.py`, which shows on others how often is right what is said; but
`around` is set, and `amid` and `sensor` are lowered, as that script says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass

FLOOR = 0.005
"""Least cost: the share of the area that edges and noise show from behind where all is right. Of
.005, .01 and .02 the least one explained 286 random scans best that were left out of the fit: their
logarithms of the likelihood added up to -59.5, -60.9 and -62.8."""
SENSED = "sensor", "flown", "places"
"""Kinds whose sensor is known, so that its rays are."""
UPS = (2, 1.0), (1, 1.0), (1, -1.0)
"""Axes that may point up, and their signs: z of maps, y of many programs, -y of cameras."""


@dataclass(frozen=True, slots=True, eq=False)
class ReadingFeatures:
    """What counts for a reading, of a `kind` that is ``outside`` or a field of `Likelihood`.

    The `cost` is the share of the area that was seen from behind, or not at all; `evenness` says
    how much more evenly points lie as seen from the sensor than on the surface, as a logarithm.
    `facing` (3,) is how much more of what lies level along an axis faces along it than against it,
    as a share of the area.
    """

    kind: str
    cost: float = 0.0
    evenness: float = 0.0
    facing: FloatArray | None = None

    def with_sides(self, cost: float, facing: FloatArray) -> ReadingFeatures:
        """Return the same with what depends on the sides."""
        return replace(self, cost=cost, facing=facing)


@dataclass(frozen=True, slots=True)
class Likelihood:
    """The numbers of the fit, as logarithms of odds.

    Parameters
    ----------
    power : float
        Of the cost.
    around, amid, side, sensor, flown, places : float
        How much more common such scans are than those from all around; of what the file tells,
        how far it is believed. No random scan is from around one axis: such scans of open tubes,
        skirts and bare walls are as likely as those from among them.
    among, evenness : float
        What points that lie evenly as seen from places among them, or from a sensor whose place is
        given, speak for these.
    facing : float
        What all that lies level says when it faces up.
    z_up, y_up : float
        How common it is that z points up, or y does, or down, beside none of them.
    held, tangle : float
        How seldom links are wrong, as no reading can tell, and by how much more often where the
        sides of one break all the links.
    """

    power: float
    around: float
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
    held: float
    tangle: float

    def odds(self, features: ReadingFeatures) -> float:
        """Return the logarithm of the odds of a reading, up to what all have in common."""
        common = 0.0 if features.kind == "outside" else getattr(self, features.kind)
        weight = self.among if features.kind == "amid" else self.evenness
        told = weight * features.evenness
        level = float(np.logaddexp.reduce([0.0, *self.ups(features)]))
        return float(common + told + level - self.power * np.log(FLOOR + features.cost))

    def ups(self, features: ReadingFeatures) -> list[float]:
        """Return the logarithms of the odds that each of `UPS` points up, beside none of them."""
        facing = np.zeros(3) if features.facing is None else features.facing
        commons = self.z_up, self.y_up, self.y_up
        return [
            common + self.facing * sign * float(facing[axis])
            for common, (axis, sign) in zip(commons, UPS, strict=True)
        ]

    def find_shares(self, features: Sequence[ReadingFeatures], broken: float) -> FloatArray:
        """Return the probabilities of readings; what they lack to 1 is that none is true.

        Parameters
        ----------
        features : sequence of ReadingFeatures
        broken : float
            Share of the links that sides break.
        """
        odds = np.array([self.odds(one) for one in features])
        shares = np.exp(odds - odds.max())
        held = 1.0 / (1.0 + np.exp(self.tangle * broken - self.held))
        # The rays of a sensor tell every side without a link.
        is_sensed = np.array([one.kind in SENSED for one in features])
        found: FloatArray = np.where(is_sensed, 1.0, held) * shares / shares.sum()
        return found


FITTED = Likelihood(
    power=2.18, around=-1.36, amid=-3.5, sensor=-3.8, flown=3.87, places=4.0, side=-2.7, among=5.86,
    evenness=8.82, facing=3.12, z_up=1.03, y_up=0.937, held=4.45, tangle=32.3,
)  # fmt: skip
