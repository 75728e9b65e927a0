"""What a scan may be, told by one measure: what its viewers should not have seen, and should have.

::

    all around, inside, amid, 26 sides, (0, 0, 0), the file's sensor
        ── look ──> what each sees ── sides follow over links ──> cost, evidence
        odds ── shares of all of them ──> how sure each side is

Nobody measured a surface from behind, nor one that he did not see. So of each reading two shares
of the area are added up: of what its viewers see, what they see from behind, and what none of them
sees. The odds of a reading fall with a power of that cost; how common such scans are, which way
what lies level faces, and how evenly the points lie as seen from a place change them: see
`likelihood`.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from hpcapp.applications.surface.normals.evidence.inside import AMID, AMPLE, INSIDE, find_inside
from hpcapp.applications.surface.normals.evidence.likelihood import (
    FITTED,
    ReadingFeatures,
)
from hpcapp.applications.surface.normals.evidence.linked import LinkedPatches
from hpcapp.applications.surface.normals.evidence.seen_sides import (
    Evidence,
    Outside,
    Views,
    areas_of,
    face_along,
    look_from,
    look_outside,
    share_of,
)
from hpcapp.applications.surface.normals.evidence.stand import Density
from hpcapp.applications.surface.normals.patches import Links, Patches
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.geometry.points import BoolArray, FloatArray
from hpccomponent.dataclass import dataclass

_FARTHEST = 3.0  # diagonals of the box that a sensor at zero may be outside of it
_AROUND = 0.2  # cosine of the angle around a direction that a view from one side comes from
_BELT = 0.25  # sine of the angle from the plane across an axis, that a view around this comes from
_STEEP = 0.7  # cosine to z of a side that the words above and below stand for
_STANDS, _LEVEL = 0.6, 0.9  # cosines to an axis of what stands and what lies level, were that up
_FOLLOWED = 4.0  # logarithm of the odds, by which others than these may be better than they look
_HINT = 0.003  # how strongly views count beside links that all agree
_SIDES = [np.array(step) / np.linalg.norm(step) for step in itertools.product((1, 0, -1), repeat=3)
          if any(step)]  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """Where a scan may have been taken from; `name` is as the kind of a `Reading`.

    From there `views` are seen; `unseen` is the share of the area that none of its viewpoints sees,
    and should. `known` counts for it whichever the sides are. `place` (3,) is on the side that it
    is seen from, in the frame of the patches; `word` is ``above`` or ``below`` for one that looks
    more up or down than across.
    """

    name: str
    views: Views
    evidence: Evidence
    unseen: float
    known: ReadingFeatures
    place: FloatArray | None = None
    word: str = ""

    def measure(
        self, areas: FloatArray, level: FloatArray, is_turned: BoolArray
    ) -> ReadingFeatures:
        """Return what counts for it with some sides; see `measure_level`."""
        views = self.views
        # The area that shows its inner side, were the reading true, by how much of it is seen.
        behind = float((areas * np.where(is_turned, views.front, views.back)).sum())
        seen = float((areas * (views.front + views.back)).sum())
        facing: FloatArray = np.einsum("p,pi->i", np.where(is_turned, -1.0, 1.0), level)
        return self.known.with_sides(behind / max(seen, 1e-300) + self.unseen, facing)


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """A hypothesis, and what follows of it: sides (p,) over the links, and its features.

    Its `share` is its probability, 0 to 1, among all that were weighed.
    """

    hypothesis: Hypothesis
    sides: FloatArray
    features: ReadingFeatures
    share: float = 0.0


def follow(linked: LinkedPatches, evidence: Evidence) -> FloatArray:
    """Return the sides that links have where evidence counts next to nothing."""
    weights = _HINT * evidence.weights
    return linked.spread(weights, evidence.leanings, np.zeros(len(weights)))


def measure_level(patches: Patches) -> FloatArray:
    """Return how much of the area lies level along each axis, by patch; below 0 if facing down.

    Returns
    -------
    ndarray of float64, shape (p, 3)
    """
    level = np.clip((np.abs(patches.normals) - _STANDS) / (_LEVEL - _STANDS), 0.0, 1.0)
    areas = areas_of(patches)
    found: FloatArray = level * np.sign(patches.normals) * (areas / areas.sum())[:, None]
    return found


def follow_reading(
    linked: LinkedPatches, hypothesis: Hypothesis, areas: FloatArray, level: FloatArray
) -> Followed:
    """Return what follows of a hypothesis over the links; see `Hypothesis.measure`."""
    sides = follow(linked, hypothesis.evidence)
    return Followed(hypothesis, sides, hypothesis.measure(areas, level, sides < 0.0))


def weigh_readings(
    patches: Patches,
    linked: LinkedPatches,
    spacing: float,
    zero: FloatArray,
    sensor: Sensor,
    threads: int = 1,
) -> list[Followed]:
    """Weigh what a cloud may be; the reading whose sides are most probable comes first.

    The patches are of the whole cloud; `zero` (3,) is where the input has (0, 0, 0), in their
    frame. What the shares lack to 1 is that none is true; some of next to no share may be missing.
    """
    hypotheses = find_readings(patches, linked, spacing, zero, sensor, threads)
    given = areas, _ = areas_of(patches), measure_level(patches)
    # What they come to if every patch could take the side of its own that is seen more.
    bounds = [
        FITTED.odds(one.measure(*given, one.views.front < one.views.back)) for one in hypotheses
    ]
    found: list[Followed] = []
    best = -np.inf
    for row in np.argsort(bounds, kind="stable")[::-1]:
        if bounds[row] < best - _FOLLOWED:
            break
        found.append(follow_reading(linked, hypotheses[row], *given))
        best = max(best, FITTED.odds(found[-1].features))
    weighed = _share(found, linked.share_broken(found[0].sides))
    # (r, p): readings that agree on a side speak for it together.
    turned = np.array([one.sides < 0.0 for one in weighed])
    shares = np.array([one.share for one in weighed])
    agreed = [float((shares * ((turned == mine) * areas).sum(axis=1)).sum()) for mine in turned]
    first = weighed[int(np.argmax(agreed))]
    return [first, *(one for one in weighed if one is not first)]


def weigh_given(
    patches: Patches,
    spacing: float,
    zero: FloatArray,
    sensor: Sensor,
    threads: int = 1,
) -> list[Followed]:
    """Weigh what a cloud may be whose patches have their sides; as for `weigh_readings`."""
    none, sides = np.empty(0, np.int64), np.ones(len(patches))
    linked = LinkedPatches(patches, Links(none, none, none, np.empty((0, 3), np.int64)))
    given = areas_of(patches), measure_level(patches)
    found = [
        Followed(one, sides, one.measure(*given, sides < 0.0))
        for one in find_readings(patches, linked, spacing, zero, sensor, threads)
    ]
    return sorted(_share(found, 0.0), key=lambda one: -one.share)


def _share(found: list[Followed], broken: float) -> list[Followed]:
    """Return the same with the probability of each, where sides break a share of the links."""
    shares = FITTED.find_shares([one.features for one in found], broken)
    return [replace(one, share=share) for one, share in zip(found, shares.tolist(), strict=True)]


def find_readings(
    patches: Patches,
    linked: LinkedPatches,
    spacing: float,
    zero: FloatArray,
    sensor: Sensor,
    threads: int = 1,
) -> list[Hypothesis]:
    """Return all readings of a cloud; as for `weigh_readings`."""
    outside = look_outside(patches, linked.components(), spacing, threads)
    toggled = outside.toggled.evidence("from outside")
    content = share_of(patches, outside.is_content)
    found = [
        Hypothesis("outside", outside.views, toggled, content, ReadingFeatures("outside")),
        *_look_from_sides(patches, outside),
        *_look_around(patches, outside),
    ]
    density = Density.of(patches, spacing)
    shares = (INSIDE, *AMID)
    among = find_inside(patches, spacing, AMPLE, threads, shares)
    seen_from = np.empty((0, 3))
    for name, places in zip(("inside", "amid", "amid"), among, strict=True):
        # Where fewer blocked directions add no place, that is no other reading.
        if not len(places) or np.array_equal(places.every, seen_from):
            continue
        seen_from = places.every
        how = "from inside" if name == "inside" else "from amid the points"
        views = Views.inside(patches, places, spacing, threads)
        known = ReadingFeatures("amid", evenness=density.favour(patches, places.every))
        unseen = share_of(patches, views.is_hidden)
        # Inside is a word of its own.
        place = None if name == "inside" else places.emptiest[0]
        found.append(Hypothesis(name, views, views.evidence(how), unseen, known, place))
    return found + _ask_sensor(patches, outside, spacing, zero, sensor, density, threads)


def _ask_sensor(
    patches: Patches,
    outside: Outside,
    spacing: float,
    zero: FloatArray,
    sensor: Sensor,
    density: Density,
    threads: int,
) -> list[Hypothesis]:
    """Return what a sensor at (0, 0, 0) saw, and the one that the file tells of.

    Rays that ended at a point have passed what is in front of it, however thick that looks at a
    grazing angle: what such a sensor does not see costs nothing.
    """
    found = []
    low, high = patches.centres.min(axis=0), patches.centres.max(axis=0)
    beyond = np.maximum(np.maximum(low - zero, zero - high), 0.0)
    if np.linalg.norm(beyond) < _FARTHEST * np.linalg.norm(high - low):
        views, seen = face_along(patches, zero - patches.centres, "from a sensor at (0, 0, 0)")
        known = ReadingFeatures("sensor", evenness=density.favour(patches, zero[None]))
        found.append(Hypothesis("sensor", views, seen, 0.0, known, zero))
    if sensor.kind == "above":  # a flight; of the others only users tell
        up = np.array([0.0, 0.0, 1.0])
        views, (_, seen) = _see_from(outside, up), face_along(patches, up, "from above")
        unseen, known = share_of(patches, views.is_hidden), ReadingFeatures("flown")
        given = views, seen, unseen, known, _lie_beside(patches, outside, up)
        found.append(Hypothesis("above", *given, "above"))
    if sensor.places is not None:
        views, seen = look_from(patches, sensor, spacing, zero, threads)
        place = sensor.places[0] + zero
        found.append(Hypothesis("places", views, seen, 0.0, ReadingFeatures("places"), place))
    return found


def _look_from_sides(patches: Patches, outside: Outside) -> list[Hypothesis]:
    """Return what is seen from each of 26 sides."""
    found = []
    for side in _SIDES:
        views = _see_from(outside, side)
        name = _name_side(side)
        seen, place = views.evidence(f"from {name}"), _lie_beside(patches, outside, side)
        word = "" if abs(side[2]) < _STEEP else "above" if side[2] > 0.0 else "below"
        unseen, known = share_of(patches, views.is_hidden), ReadingFeatures("side")
        found.append(Hypothesis(name, views, seen, unseen, known, place, word))
    return found


def _look_around(patches: Patches, outside: Outside) -> list[Hypothesis]:
    """Return what is seen by who goes round along one of the axes, and not over the ends.

    Most of the viewpoints all around see what these see: ``outside`` is the option that tells it.
    """
    found = []
    for axis, name in enumerate("xyz"):
        rows = np.flatnonzero(np.abs(outside.directions[:, axis]) < _BELT)
        views = Views.sum(outside.cosines[rows], outside.is_seen[rows], len(rows))
        seen, unseen = views.evidence(f"from all around {name}"), share_of(patches, views.is_hidden)
        known = ReadingFeatures("around")
        given = views, seen, unseen, known, None, "outside"
        found.append(Hypothesis(f"around {name}", *given))
    return found


def _see_from(outside: Outside, side: FloatArray) -> Views:
    """Return what those of the viewpoints all around see that lie about on a side."""
    rows = np.flatnonzero(outside.directions @ side > _AROUND)
    return Views.sum(outside.cosines[rows], outside.is_seen[rows], len(rows))


def _lie_beside(patches: Patches, outside: Outside, side: FloatArray) -> FloatArray:
    """Return a place on a side of a cloud."""
    middle = 0.5 * (patches.centres.min(axis=0) + patches.centres.max(axis=0))
    place: FloatArray = middle + outside.radius * side
    return place


def _name_side(side: FloatArray) -> str:
    """Return its name: ``above``, ``+x``, ``-x+y``."""
    signs = [f"{part:+.0f}"[0] * bool(part) for part in np.sign(side)]
    axes = "".join(sign + axis for sign, axis in zip(signs, "xyz", strict=True) if sign)
    return {"+z": "above", "-z": "below"}.get(axes, axes)
