"""What a scan is of and how it was seen: judged once, and taken by all that follows.

::

    normals, given or estimated ──> Reading ──> closing, hull, warnings, report, up
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, Self

import numpy as np

from hpccomponent.dataclass import dataclass

AMONG = "inside", "amid", "sensor"
"""Kinds that were seen from among the points."""
_SEEN = {
    "inside": "from inside",
    "amid": "from amid the points",
    "sensor": "from a sensor at (0, 0, 0)",
    "places": "from where the sensor was",
}


SURE = 0.8
"""Probability from which on a side, or a reading, is believed without a word. Of 457 scans 409 were
said to be surer than that, and 396 of these were right, by a fit without them
(`benchmarks/results/readings.json`); with .85 as many are wrong in silence of the hundred random
worlds that are checked, and two more are warned of that are right."""


@dataclass(frozen=True, slots=True)
class Rival:
    """What a scan may be instead, how probably, and what ``--viewpoint`` says so, if anything."""

    kind: str
    probability: float
    option: str = ""


@dataclass(frozen=True, slots=True)
class Measurement:
    """What a reading rests on: a number with its name and unit."""

    name: str
    value: float
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Reading:
    """What a scan is of, and how it was seen.

    Parameters
    ----------
    kind : str
        Where it was seen from: ``outside`` (all around), ``around z`` (and not over the ends),
        ``inside``, ``amid`` (among the points), ``above``, ``below``, a side (``+y-z``),
        ``sensor`` (at zero), ``places``.
    certainty : float
        Probability of the kind, 0 to 1; 0 where nobody has looked.
    up : str or None
        The axis of the input that is known to point up, of `axis_names.AXES`; None where only the
        mesh can tell, by what it stands on.
    missing : tuple of float
        Minus the mean normal by area: its direction is the side that was not seen, its length
        tells how much of it, 0 to 1.
    drawn : float
        How far the surface goes on, at its border, towards the missing side: a mean cosine.
    rivals : tuple of Rival
        The likeliest first.
    because : tuple of Measurement
    """

    kind: str = "outside"
    certainty: float = 0.0
    up: str | None = None
    missing: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drawn: float = 0.0
    rivals: tuple[Rival, ...] = ()
    because: tuple[Measurement, ...] = ()

    @property
    def share_going_on(self) -> float:
        """How probable it is that it goes on where nobody looked: 0 to 1.

        As a room or a street does, which is seen from among its points, and ground, which is seen
        from above where z is known to be up.
        """
        if self.kind == "above" and self.up is not None:
            return 1.0
        weighed = [
            (self.kind, self.certainty),
            *((one.kind, one.probability) for one in self.rivals),
        ]
        # Known places lie among the points or around them, as the likeliest of the others says.
        if self.kind == "places":
            weighed = weighed[1:2]
        among, others = (
            max((share for kind, share in weighed if (kind in AMONG) == is_among), default=0.0)
            for is_among in (True, False)
        )
        share = among / (among + others) if among else 0.0
        return share if 1.0 - SURE < share < SURE else round(share)

    @property
    def share_missing(self) -> float:
        """The length of `missing`."""
        return float(np.sqrt(sum(part * part for part in self.missing)))

    @property
    def seen(self) -> str:
        """Where it was seen from, in words."""
        return _SEEN.get(self.kind, f"from {self.kind}")

    def to_json(self) -> dict[str, Any]:
        """Return it for the report: JSON values."""
        return asdict(self)

    @classmethod
    def of_json(cls, told: dict[str, Any]) -> Self:
        """Return what `to_json` has told."""
        rivals = tuple(Rival(**one) for one in told["rivals"])
        because = tuple(Measurement(**one) for one in told["because"])
        missing = tuple(told["missing"])
        return cls(**{**told, "missing": missing, "rivals": rivals, "because": because})


UNREAD = Reading()
"""Of points that nobody has read: nothing is known to be missing."""
