"""Which side of each patch faces free space: from a sensor, or from views of the whole object.

::

    places, a flight ───────────────────────────> evidence that is believed
    views from outside, shell by shell ──> one hypothesis ┐  what breaks the fewest links and
    views from inside ───────────────────> another one    ┴─ leaves the least unseen is taken
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpcapp.applications.surface.normals.patches import CELL, Patches
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.applications.surface.normals.visibility import poll_views, stand_inside, surround
from hpcapp.applications.surface.types.points import BoolArray, FloatArray, IntArray

__all__ = [
    "Evidence",
    "Outside",
    "Views",
    "areas_of",
    "face_along",
    "hear_sensor",
    "look_inside",
    "look_outside",
    "share_of",
]

_VIEWS = 64
_GLIMPSE = 0.005  # mean of cosines over all views: what is seen less is hidden
_CLEAR = 0.5  # share of the views that makes a patch's leaning a whole one
_BELIEVED = 0.5  # share of the area that may be hidden from scanners that a file names
_LEVEL = 0.75  # of the longest side, below which the height of what was flown over is
_GAP, _FARTHEST = 0.1, 10.0  # longest sides between an object and a camera at zero
_FIELD = 0.5  # cosine of half the angle that a camera sees
_INSIDE_FIELD = 0.98  # share of the patches that lie there
_OCCLUDED = 0.3  # share of the area that may be hidden from it
_SHELLS = 4  # inside each other
_SHOWN = 0.25  # share of a component that must be seen from outside
_ALIKE = 0.3  # of the better seen side, that the other one shows
_CLOSED = 0.1  # share of a shell that may be seen from both sides


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What is known of the sides of patches.

    Parameters
    ----------
    leanings : ndarray of float64, shape (p,)
        From -1, the normal points into what is solid, to 1: it points to where the sensor was.
    weights : ndarray of float64, shape (p,)
        How much is known, 0 to 1.
    how : str
        Where it comes from, for people.
    is_sensed : bool
        Whether it is of the sensor that took the points; else of views that might have been.
    certainty : float
        0 to 1: how sure the side of the whole is.
    """

    leanings: FloatArray
    weights: FloatArray
    how: str
    is_sensed: bool = False
    certainty: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """How much of the two sides of each patch some viewpoints see.

    Parameters
    ----------
    front, back : ndarray of float64, shape (p,)
        What `poll_views` has returned, by the number of viewpoints.
    """

    front: FloatArray
    back: FloatArray

    @classmethod
    def of(cls, patches: Patches, viewpoints: FloatArray, spacing: float) -> Views:
        """Look from some viewpoints."""
        front, back = poll_views(patches, viewpoints, spacing)
        return cls(front / len(viewpoints), back / len(viewpoints))

    @property
    def is_hidden(self) -> BoolArray:
        """Of which patches none of the viewpoints shows anything."""
        hidden: BoolArray = self.front + self.back < _GLIMPSE
        return hidden

    @property
    def is_alike(self) -> BoolArray:
        """Of which patches both sides are seen: those of a sheet."""
        alike: BoolArray = np.minimum(self.front, self.back) > _ALIKE * np.maximum(
            self.front, self.back
        )
        return alike

    def evidence(self, how: str, *, is_sensed: bool = False) -> Evidence:
        """Return it as evidence: free space is where most of the viewpoints are."""
        whole = _CLEAR / 4.0  # a half space of directions sums up to a quarter of all
        leanings = np.clip((self.front - self.back) / whole, -1.0, 1.0)
        weights = np.minimum((self.front + self.back) / whole, 1.0)
        return Evidence(leanings, weights, how, is_sensed)


def areas_of(patches: Patches) -> FloatArray:
    """Return how much area patches have, 0 to 1: in faces of a cell."""
    areas: FloatArray = np.minimum(patches.counts / CELL**2, 1.0)
    return areas


def share_of(patches: Patches, chosen: BoolArray) -> float:
    """Return the share of the area that some patches have."""
    areas = areas_of(patches)
    return float(areas[chosen].sum() / areas.sum())


def face_along(patches: Patches, axis: int, sign: float, how: str, *, is_sensed: bool) -> Evidence:
    """Return the evidence that all was seen from far away along an axis."""
    along = sign * patches.normals[:, axis]
    return Views(np.maximum(along, 0.0), np.maximum(-along, 0.0)).evidence(how, is_sensed=is_sensed)


def hear_sensor(
    patches: Patches, spacing: float, zero: FloatArray, sensor: Sensor
) -> Evidence | None:
    """Return what is known from the sensor; None where nothing is, or nothing to be believed.

    Parameters
    ----------
    patches : Patches
        Of a whole cloud.
    spacing : float
        Of the cloud, in length units of the input.
    zero : ndarray of float64, shape (3,)
        Where the input has (0, 0, 0), in the frame of the patches.
    sensor : Sensor
        What a user has told is believed. What a file tells is where it can be: of scanners, if
        they see half of the object; of a flight, if that is not as high as it is wide, for some
        scanners on tripods write the same. Where nothing is told, and the object lies before
        `zero` and is seen from there, a camera was there.
    """
    if sensor.kind == "inside":
        return look_inside(patches, spacing).evidence("from inside")
    if sensor.kind in ("above", "below"):
        size = np.ptp(patches.centres, axis=0)
        sign = 1.0 if sensor.kind == "above" else -1.0
        if sensor.is_told or size[2] < _LEVEL * size.max():
            return face_along(patches, 2, sign, f"from {sensor.kind}", is_sensed=True)
        return None
    if sensor.places is not None:
        views = Views.of(patches, sensor.places + zero, spacing)
        if sensor.is_told or share_of(patches, views.is_hidden) < _BELIEVED:
            return views.evidence("from where the scanner stood", is_sensed=True)
        return None
    if not _lies_before(patches, zero):
        return None
    views = Views.of(patches, zero[None], spacing)
    if share_of(patches, views.is_hidden) > _OCCLUDED:
        return None
    return views.evidence("from a camera at (0, 0, 0)", is_sensed=True)


def look_inside(patches: Patches, spacing: float) -> Views:
    """Look from the emptiest places inside: what a room shows."""
    return Views.of(patches, stand_inside(patches), spacing)


@dataclass(frozen=True, slots=True, eq=False)
class Outside:
    """What is seen from all around.

    Parameters
    ----------
    views : Views
        Of the whole.
    toggled : Views
        Of shell after shell. Crossing a surface toggles: what is hidden by a shell is looked at
        without it, and faces inwards; what is hidden by that, outwards again.
    is_content : ndarray of bool, shape (p,)
        Patches that are hidden, and not those of a cavity: of a closed shell inside another one.
    """

    views: Views
    toggled: Views
    is_content: BoolArray


def look_outside(patches: Patches, components: IntArray, spacing: float) -> Outside:
    """Look from all around.

    Parameters
    ----------
    patches : Patches
        Of a whole cloud.
    components : ndarray of int64, shape (p,)
        Which patches hang together.
    spacing : float
        Of the cloud, in length units of the input.
    """
    viewpoints = surround(patches, _VIEWS)
    whole = shown = Views.of(patches, viewpoints, spacing)
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
        sides = (front, back) if shell % 2 == 0 else (back, front)
        for side, found in zip(sides, (shown.front, shown.back), strict=True):
            side[rows[taken]] = found[taken]
        rows = rows[~taken]
        if not (len(rows) and taken.any()):
            break
        shown = Views.of(patches.take(rows), viewpoints, spacing)
    return Outside(whole, Views(front, back), is_content)


def _lies_before(patches: Patches, zero: FloatArray) -> bool:
    """Tell whether an object may be what a camera at zero saw."""
    low, high = patches.centres.min(axis=0), patches.centres.max(axis=0)
    gap = np.maximum(np.maximum(low - zero, zero - high), 0.0)
    gaps = float(np.sqrt((gap * gap).sum())) / max(float((high - low).max()), 1e-300)
    if not _GAP < gaps < _FARTHEST:
        return False
    arms = patches.centres - zero
    arms /= np.sqrt(np.einsum("ij,ij->i", arms, arms))[:, None]
    axis = arms.mean(axis=0)
    cosines = arms @ (axis / np.sqrt(axis @ axis))
    return bool(np.quantile(cosines, 1.0 - _INSIDE_FIELD) > _FIELD)
