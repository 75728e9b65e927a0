"""Which side of each patch faces free space: what viewpoints see, and what a sensor has told.

::

    viewpoints ── look ──> how much of both sides of each patch they see ──> evidence
    places of a scanner, a flight, a user ──> evidence that is believed
"""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.normals.evidence.inside import (
    AMID,
    INSIDE,
    TIGHT,
    Places,
    find_inside,
)
from hpcapp.applications.surface.normals.evidence.visibility import look, surround
from hpcapp.applications.surface.normals.patches import CELL, Patches
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.geometry.points import BoolArray, FloatArray, Int8Array, IntArray
from hpcapp.kernels import WHOLE
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

VIEWS = 64
"""Viewpoints around an object."""

_CLEAR = 0.125  # of the viewpoints: the sum of cosines that makes a patch's leaning a whole one
_AT_ONCE = 16  # viewpoints, of which no more than the sums is kept
_FEW = 8  # viewpoints that see a patch from among things: others see other parts
_SHELLS = 4  # inside each other
_SHOWN = 0.25  # share of a component that must be seen from outside
_ALIKE = 0.3  # of the better seen side, that the other one shows
_CLOSED = 0.1  # share of a shell that may be seen from both sides


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What is known of the sides of patches; `how` says where it comes from, for people.

    `leanings` (p,) go from -1, the normal points into what is solid, to 1: it points to where the
    sensor was; `weights` (p,) tell how much is known, 0 to 1. It is of the sensor that took the
    points where it `is_sensed`; else of views that might have been.
    """

    leanings: FloatArray
    weights: FloatArray
    how: str
    is_sensed: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """How much of the two sides of each patch some viewpoints see.

    `front` and `back` (p,) are cosines between the normal, or its opposite, and the directions it
    is seen from, summed; a sum of `whole` is clear evidence. Of what `is_hidden` (p,) none of the
    viewpoints shows anything.
    """

    front: FloatArray
    back: FloatArray
    whole: float
    is_hidden: BoolArray

    @classmethod
    def sum(cls, cosines: Int8Array, is_seen: BoolArray, viewpoints: float) -> Views:
        """Add up what `look` has returned; so many of the viewpoints could see a patch."""
        # (p,) each: cosines in 127ths, above 0 where the normal points to the viewpoint.
        front, back, is_shown = kernels.add_views(cosines, is_seen)
        return cls(front / WHOLE, back / WHOLE, _CLEAR * viewpoints, ~is_shown)

    @classmethod
    def of(
        cls,
        patches: Patches,
        places: FloatArray,
        viewpoints: float,
        spacing: float,
        threads: int = 1,
    ) -> Views:
        """Look from some places; so many of them could see a patch."""
        front, back = np.zeros((2, len(patches)), np.int64)
        is_hidden = np.ones(len(patches), np.bool_)
        for start in range(0, len(places), _AT_ONCE):
            some = places[start : start + _AT_ONCE]
            more = kernels.add_views(*look(patches, some, spacing, threads))
            front += more[0]
            back += more[1]
            is_hidden &= ~more[2]
        return cls(front / WHOLE, back / WHOLE, _CLEAR * viewpoints, is_hidden)

    @classmethod
    def inside(cls, patches: Patches, places: Places, spacing: float, threads: int = 1) -> Views:
        """Look from places inside, as far as they reach; a patch is seen from a few of them."""
        front, back = np.zeros((2, len(patches)))
        is_hidden = np.ones(len(patches), np.bool_)
        viewpoints = min(len(places), _FEW)
        for start in range(0, len(places), _AT_ONCE):
            some = places.every[start : start + _AT_ONCE]
            low, high = some.min(axis=0) - places.reach, some.max(axis=0) + places.reach
            rows = np.flatnonzero(((patches.centres > low) & (patches.centres < high)).all(axis=1))
            near = cls.of(patches.take(rows), some, viewpoints, spacing, threads)
            front[rows] += near.front
            back[rows] += near.back
            is_hidden[rows] &= near.is_hidden
        return cls(front, back, _CLEAR * viewpoints, is_hidden)

    @property
    def is_alike(self) -> BoolArray:
        """Of which patches both sides are seen: those of a sheet."""
        alike: BoolArray = np.minimum(self.front, self.back) > _ALIKE * np.maximum(
            self.front, self.back
        )
        return alike

    def evidence(self, how: str, *, is_sensed: bool = False) -> Evidence:
        """Return it as evidence: free space is where most of the viewpoints are."""
        leanings = np.clip((self.front - self.back) / self.whole, -1.0, 1.0)
        weights = np.minimum((self.front + self.back) / self.whole, 1.0)
        return Evidence(leanings, weights, how, is_sensed)


def areas_of(patches: Patches) -> FloatArray:
    """Return how much area patches have, 0 to 1: in faces of a cell."""
    areas: FloatArray = np.minimum(patches.counts / CELL**2, 1.0)
    return areas


def share_of(patches: Patches, chosen: BoolArray) -> float:
    """Return the share of the area that some patches have."""
    areas = areas_of(patches)
    return float(areas[chosen].sum() / areas.sum())


def face_along(patches: Patches, rays: FloatArray, how: str) -> tuple[Views, Evidence]:
    """Return what is seen along rays (3,) or (p, 3) back to the sensor, and that as evidence.

    The rays may have any length; `how` says where they come from, for people.
    """
    lengths = np.maximum(np.linalg.norm(rays, axis=-1), 1e-300)
    along = (patches.normals * rays).sum(axis=1) / lengths
    shown = np.maximum(along, 0.0), np.maximum(-along, 0.0)
    views = Views(*shown, _CLEAR, np.zeros(len(patches), np.bool_))
    return views, views.evidence(how, is_sensed=True)


def hear_user(
    patches: Patches,
    components: IntArray,
    spacing: float,
    zero: FloatArray,
    sensor: Sensor,
    threads: int = 1,
) -> Evidence:
    """Return the evidence of a sensor that a user tells of, who is believed.

    `components`, (p,), tell which patches of a whole cloud hang together; `zero`, (3,), is where
    the input has (0, 0, 0), in their frame. InputError where somebody was inside, and no place
    inside is found.
    """
    if sensor.kind == "inside":
        # The most enclosed places that there are: a street has none that a room would have.
        found = find_inside(patches, spacing, TIGHT, threads, (INSIDE, *AMID))
        places = next((some for some in found if len(some)), None)
        if places is None:
            raise InputError(
                f"{name_option('viewpoint', 'inside')}: no place inside was found: nothing "
                "surrounds the points",
                f"give where the sensor was ({name_option('viewpoint')}: X,Y,Z or path.csv)",
            )
        return Views.inside(patches, places, spacing, threads).evidence("from inside")
    if sensor.kind in ("above", "below"):
        sign = 1.0 if sensor.kind == "above" else -1.0
        return face_along(patches, np.array([0.0, 0.0, sign]), f"from {sensor.kind}")[1]
    if sensor.places is None:
        outside = look_outside(patches, components, spacing, threads)
        return outside.toggled.evidence("from outside")
    return look_from(patches, sensor, spacing, zero, threads)[1]


def look_from(
    patches: Patches, sensor: Sensor, spacing: float, zero: FloatArray, threads: int = 1
) -> tuple[Views, Evidence]:
    """Return what a sensor sees whose places are known, and that as evidence."""
    assert sensor.places is not None  # noqa: S101 - it is of that kind
    places = sensor.places + zero
    views = Views.of(patches, places, len(places), spacing, threads)
    return views, views.evidence(f"from where the {sensor.noun}", is_sensed=True)


@dataclass(frozen=True, slots=True, eq=False)
class Outside:
    """What is seen from all around.

    `cosines` and `is_seen` (v, p) are what each viewpoint sees of the whole; see `look`. Viewpoints
    are in `directions` (v, 3) from the middle, of unit length, `radius` away; `views` are those of
    the whole. Those `toggled` are of shell after shell. Crossing a surface toggles: what is hidden
    by a shell is looked at without it, and faces inwards; what is hidden by that, outwards again.
    What `is_content` (p,) is hidden, and not of a cavity: of a closed shell inside another one.
    """

    cosines: Int8Array
    is_seen: BoolArray
    directions: FloatArray
    radius: float
    views: Views
    toggled: Views
    is_content: BoolArray


def look_outside(
    patches: Patches, components: IntArray, spacing: float, threads: int = 1
) -> Outside:
    """Look at a whole cloud from all around.

    `components`, (p,), tell which patches hang together.
    """
    directions, radius, viewpoints = surround(patches, VIEWS)
    cosines, is_seen = look(patches, viewpoints, spacing, threads)
    whole = shown = Views.sum(cosines, is_seen, VIEWS)
    # (p,) each: what each side shows once the shells around it are gone; `rows` are the patches of
    # no shell so far.
    front, back = np.zeros(len(patches)), np.zeros(len(patches))
    is_content = whole.is_hidden
    rows = np.arange(len(patches))
    for shell in range(_SHELLS):
        # Of the patches that are left: their components, and which of these are seen enough.
        some, numbers = patches.take(rows), components[rows]
        counts = np.maximum(np.bincount(numbers, some.counts), 1.0)
        taken = (np.bincount(numbers, some.counts * ~shown.is_hidden) > _SHOWN * counts)[numbers]
        if shell:  # what is closed lines a cavity, or lies in one
            alike = np.bincount(numbers, some.counts * shown.is_alike)
            is_content[rows[taken & (alike < _CLOSED * counts)[numbers]]] = False
        # Each second shell shows its inner side: between it and the one around it is solid matter.
        sides = (front, back) if shell % 2 == 0 else (back, front)
        for side, found in zip(sides, (shown.front, shown.back), strict=True):
            side[rows[taken]] = found[taken]
        rows = rows[~taken]
        if not (len(rows) and taken.any()):
            break
        # What was seen so far is taken away, and the viewpoints see the next shell.
        shown = Views.of(patches.take(rows), viewpoints, VIEWS, spacing, threads)
    toggled = Views(front, back, whole.whole, whole.is_hidden)
    return Outside(cosines, is_seen, directions, radius, whole, toggled, is_content)
