"""What a scan may be, told by one measure: what its viewers should not have seen, and should have.

::

    all around, inside, 26 sides, zero ── look ──> what each sees ── sides follow over links ──┐
        cost = seen from behind + seen by none + how rare  <───────────────────────────────────┘
        the least is believed, as far as it costs less than the others

Nobody measured a surface from behind, nor one that he did not see. So of each reading two shares
of the area are added up: of what its viewers see, what they see from behind, and what none of them
sees.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from hpcapp.applications.surface.normals.evidence import (
    Evidence,
    Outside,
    Views,
    areas_of,
    look_outside,
    share_of,
)
from hpcapp.applications.surface.normals.inside import AMPLE, find_inside
from hpcapp.applications.surface.normals.linked import LinkedPatches
from hpcapp.applications.surface.normals.patches import Patches
from hpcapp.applications.surface.normals.stand import has_stand
from hpcapp.geometry.points import BoolArray, FloatArray
from hpccomponent.dataclass import dataclass

CERTAIN = 0.047
"""Cost from one reading to the next from which on the first one is certain, and from .3 of it on
sure: right ones have .018 and more but two (a terrain that a camera at zero would see as well, a
falcon on a table: .011), a wrong one, of a desk before a depth camera, .010."""

RARE = 0.026
"""What it costs that few scans are taken from inside. Without it objects (boxes, one on a table)
cost up to .015 less from inside than from outside, rooms .037 less and more."""
STAND = 0.1
"""What all other readings cost where a tripod stood inside."""
HABIT = 0.06
"""What a view from below costs more than one from above: z is up, most often."""
GROUND = 0.12
"""And what it costs more where the thing lies level, wide in x and y and thin in z: few look at the
ground from below. A yard or a street that somebody stood in is a bowl, which is seen from below
without a fault, and from above with .01 to .04 more."""

_THIN = 0.6  # thickness of what lies level by its width: streets .51, objects and rooms all
# Half width of an image by its distance: of Kinect .54, of Azure Kinect 1.73. Farther aside a level
# sheet is not seen, so that a larger one decides nothing.
_SIGHT = 1.8
_SWAY = 0.05 * np.array(list(itertools.product((1, -1), (1, -1), (0,))))
"""Places of a camera at zero, by its distance. Of a sheet it sees 93 % and more from one, as pixels
happen to fall, and all from these."""
_LEVEL = 0.72  # cosine of its thin axis to z: a hillside of 35 degrees .82, a corner .63
_AROUND = 0.2  # cosine of the angle around a direction that a view from one side comes from
_ALONE = 0.5  # and of that within which one of two such views is enough
_STEEP = 0.7  # cosine to z of a side that the words above and below stand for
_TRIED = 6  # readings that are followed: in a tangle, many promise much
_HINT = 0.003  # how strongly views count beside links that all agree
_SIDES = [np.array(step) / np.linalg.norm(step) for step in itertools.product((1, 0, -1), repeat=3)
          if any(step)]  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Where a scan may have been taken from.

    Parameters
    ----------
    kind : str
        ``outside``, ``inside``, ``above``, ``below``, the axes of a side, ``+y-z``, or ``camera``:
        at (0, 0, 0), along z.
    views : Views
        What is seen from there.
    evidence : Evidence
    unseen : float
        Share of the area that is seen from none of its viewpoints.
    rare : float
        What it costs that few scans are taken so.
    habit : float or None
        Of a view from one side, or a camera, what it costs that axes are seldom laid so: it
        decides between sides where nothing else does, and makes nothing certain.
    place : ndarray of float64, shape (3,), or None
        A place on the side that it is seen from, in the frame of the patches.
    word : str
        ``above`` or ``below`` for one that looks more up or down than across.
    """

    kind: str
    views: Views
    evidence: Evidence
    unseen: float
    rare: float
    habit: float | None = None
    place: FloatArray | None = None
    word: str = ""

    def cost(self, patches: Patches, is_turned: BoolArray) -> float:
        """Return the share of what is seen that is seen from behind, and all else it costs."""
        views = self.views
        areas = areas_of(patches)
        # The area that shows its inner side, were the reading true, by how much of it is seen.
        behind = (areas * np.where(is_turned, views.front, views.back)).sum()
        seen = (areas * (views.front + views.back)).sum()
        return float(behind / max(seen, 1e-300)) + self.unseen + self.rare


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """A reading, and what follows of it.

    Parameters
    ----------
    reading : Reading
    sides : ndarray of float64, shape (p,)
        Over the links.
    cost : float
        Shares of the area, and how rare it is.
    """

    reading: Reading
    sides: FloatArray
    cost: float


def follow(linked: LinkedPatches, evidence: Evidence) -> FloatArray:
    """Return the sides that links have where evidence counts next to nothing."""
    weights = _HINT * evidence.weights
    return linked.spread(weights, evidence.leanings, np.zeros(len(weights)))


def weigh_readings(
    patches: Patches,
    linked: LinkedPatches,
    spacing: float,
    zero: FloatArray | None,
    threads: int = 1,
) -> list[Followed]:
    """Find the readings that are not refuted, the best one first.

    Parameters
    ----------
    patches : Patches
        Of a whole cloud.
    linked : LinkedPatches
    spacing : float
        Of the cloud, in length units of the input.
    zero : ndarray of float64, shape (3,), or None
        Where the input has (0, 0, 0), in the frame of the patches, if somebody may be there.

    Returns
    -------
    list of Followed
        Of the others, those that cost `CERTAIN` more may be missing.
    """
    readings = find_readings(patches, linked, spacing, zero, threads)
    # What is left if every patch could take the side of its own that is seen more.
    bounds = [
        reading.cost(patches, reading.views.front < reading.views.back) for reading in readings
    ]
    found: list[Followed] = []
    for row in np.argsort(bounds, kind="stable"):
        # The bounds rise: once one exceeds the least cost by so much, what follows can neither be
        # the best reading nor cast doubt on it.
        least = min((other.cost + (other.reading.habit or 0.0) for other in found), default=np.inf)
        if bounds[row] > least + CERTAIN or len(found) == _TRIED:
            break
        found.append(follow_reading(patches, linked, readings[row]))
    costs = [followed.cost for followed in found]
    best = found[choose(costs, [followed.reading.habit for followed in found])]
    return [best, *(other for other in found if other is not best)]


def choose(costs: Sequence[float], habits: Sequence[float | None]) -> int:
    """Return which of some readings is believed.

    Parameters
    ----------
    costs : sequence of float
    habits : sequence of float or None
        See `Reading`.
    """
    aside = [row for row, habit in enumerate(habits) if habit is not None]
    # Habit tells which side is the best one; that competes with the rest by its cost alone.
    aside.sort(key=lambda row: costs[row] + (habits[row] or 0.0))
    others = [row for row, habit in enumerate(habits) if habit is None]
    return min(aside[:1] + others, key=lambda row: costs[row])


def follow_reading(patches: Patches, linked: LinkedPatches, reading: Reading) -> Followed:
    """Return what follows of a reading over the links."""
    sides = follow(linked, reading.evidence)
    return Followed(reading, sides, reading.cost(patches, sides < 0.0))


def find_readings(
    patches: Patches,
    linked: LinkedPatches,
    spacing: float,
    zero: FloatArray | None,
    threads: int = 1,
) -> list[Reading]:
    """Return all readings of a cloud; as for `weigh_readings`."""
    outside = look_outside(patches, linked.components(), spacing, threads)
    places = find_inside(patches, spacing, AMPLE, threads)
    # Whoever stood inside has scanned neither from outside nor from one side.
    aside = STAND if len(places) and has_stand(patches, spacing) else 0.0
    toggled = outside.toggled.evidence("from outside")
    found = [
        Reading("outside", outside.views, toggled, share_of(patches, outside.is_content), aside)
    ]
    if len(places):
        views = Views.inside(patches, places, spacing, threads)
        unseen = share_of(patches, views.is_hidden)
        found.append(Reading("inside", views, views.evidence("from inside"), unseen, RARE))
    if zero is not None and _may_see(away := np.abs(patches.centres - zero)):
        places = zero + np.median(away[:, 2]) * _SWAY
        views = Views.of(patches, places, len(places), spacing, threads)
        seen = views.evidence("from a camera at (0, 0, 0)")
        unseen = share_of(patches, views.is_hidden)
        found.append(Reading("camera", views, seen, unseen, aside, HABIT, zero))
    return found + _look_from_sides(patches, outside, aside)


def _may_see(away: FloatArray) -> bool:
    """Tell whether a camera that looks along z sees all that is so far from it: none is aside."""
    return bool((away[:, :2].max(axis=1) < _SIGHT * away[:, 2]).all())


def _look_from_sides(patches: Patches, outside: Outside, rare: float) -> list[Reading]:
    """Return what is seen from one side, for the sides that explain more than those beside them."""
    found = []
    ground = GROUND * lies_level(patches)
    middle = 0.5 * (patches.centres.min(axis=0) + patches.centres.max(axis=0))
    for side in _SIDES:
        # Such viewpoints of those all around as lie about on this side.
        rows = np.flatnonzero(outside.directions @ side > _AROUND)
        views = Views.sum(outside.cosines[rows], outside.is_seen[rows], len(rows))
        name = _name_side(side)
        # 0 from above, 1 from below.
        downwards = 0.5 * (1.0 - float(side[2]))
        habit, cost = HABIT * downwards, rare + ground * downwards
        unseen = share_of(patches, views.is_hidden)
        seen, place = views.evidence(f"from {name}"), middle + outside.radius * side
        word = "" if abs(side[2]) < _STEEP else "above" if side[2] > 0.0 else "below"
        found.append(Reading(name, views, seen, unseen, cost, habit, place, word))
    bounds = [
        reading.cost(patches, reading.views.front < reading.views.back) + (reading.habit or 0.0)
        for reading in found
    ]
    # The best sides first; one that is near a better one is no reading of its own.
    kept: list[int] = []
    for row in np.argsort(bounds, kind="stable"):
        if all(_SIDES[row] @ _SIDES[other] < _ALONE for other in kept):
            kept.append(int(row))
    return [found[row] for row in kept]


def lies_level(patches: Patches) -> bool:
    """Tell whether a cloud is wide in x and y, and thin in z."""
    areas = areas_of(patches)
    arms = patches.centres - np.average(patches.centres, axis=0, weights=areas)
    # (3,), (3, 3): squared spreads along the principal axes, and these; the thinnest one first.
    spreads, axes = np.linalg.eigh(np.einsum("n,ni,nj->ij", areas, arms, arms))
    is_thin = spreads[0] < _THIN**2 * spreads[1]
    return bool(is_thin and abs(axes[2, 0]) > _LEVEL)


def _name_side(side: FloatArray) -> str:
    """Return its name: ``above``, ``+x``, ``-x+y``."""
    signs = [f"{part:+.0f}"[0] * bool(part) for part in np.sign(side)]
    axes = "".join(sign + axis for sign, axis in zip(signs, "xyz", strict=True) if sign)
    return {"+z": "above", "-z": "below"}.get(axes, axes)
