"""The side of every patch, over the whole object at once.

::

    evidence ── where links agree ──┐
    far field of the signed normals ┴─> leanings of patches ── spread over links ──> sides
                    └────────────────────── until none changes ────────────────────────┘
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hpcapp.applications.surface.kernels import integrate_normals, sample_grid
from hpcapp.applications.surface.normals.evidence import (
    Evidence,
    Views,
    areas_of,
    face_along,
    hear_sensor,
    look_inside,
    look_outside,
    share_of,
)
from hpcapp.applications.surface.normals.linked import LinkedPatches
from hpcapp.applications.surface.normals.patches import CELL, Links, Patches, Sides
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.applications.surface.normals.stand import has_stand
from hpcapp.applications.surface.types.points import BoolArray, FloatArray, IntArray

__all__ = ["SURE", "Orientation", "orient_patches"]

SURE = 0.3
"""From this confidence on the side of a patch counts as sure."""

_HINT = 0.003  # how strongly views count beside links that all agree
_LEAN = 0.3  # how strongly all that is known of a patch counts beside its links
_SHOWN, _TRIFLE = 0.2, 5e-4  # of the content of a room that is hidden inside, too; and of its area
_HIDING = 0.08  # share of the area that no scan of an object hides from all sides
_TANGLED = 0.07  # links that a flat sheet may break
_FEWEST = 8  # patches that hide together: fewer are noise
_BROKEN, _BETTER = 0.01, 0.35  # links that a view from outside breaks, and one from inside
_OPEN = 0.35  # share of the area that is seen from both sides: a sheet
_CONVEX = 0.75  # mean excess of what the outer side shows from where on it is no ground
_TWICE = 2.0  # as many links as a view from outside may be broken by a ground
_FLAT = 0.6  # of the longest side, below which a sheet is a ground
_LEVEL = 0.85  # share of a ground that faces up, less what faces down
_GUESSED = 0.25  # certainty of a side that no evidence tells
_NODES = 128
_PADDING = 1.3
_ROUNDS = 12
_SETTLED = 1e-3  # share of patches that still change sides


@dataclass(frozen=True, slots=True, eq=False)
class Orientation:
    """The sides of the patches of a cloud.

    Parameters
    ----------
    sides : Sides
    how : str
        Where the evidence comes from, for people.
    doubted : ndarray of float64, shape (3,), or None
        The middle of the largest piece whose side is unsure, in the frame of the patches; where
        a sensor has told, nothing more can be told.
    """

    sides: Sides
    how: str
    doubted: FloatArray | None


def orient_patches(
    patches: Patches, links: Links, spacing: float, zero: FloatArray, sensor: Sensor
) -> Orientation:
    """Find the side of each patch.

    Parameters
    ----------
    patches : Patches
        Of a whole cloud.
    links : Links
        Between them.
    spacing : float
        Of the cloud, in length units of the input.
    zero : ndarray of float64, shape (3,)
        Where the input has (0, 0, 0), in the frame of the patches.
    sensor : Sensor

    Notes
    -----
    A ray went to every point. Where it came from is evidence, and links and the far field fill in.
    Where nobody knows, exactly one side of every surface is free space: what is seen from outside
    is one hypothesis, what is seen from inside another. The second one is taken where a tripod
    stood inside, where a shell hides what inside shows, or where it breaks far fewer links. A
    flat sheet that is seen from both sides alike is a ground: it faces up.

    Views show the inside of an object, too, where a part of it was not scanned. So the evidence
    is spread over links first, in which it counts next to nothing, and what contradicts the
    result is left out. Then the sides are drawn to what the rest of it says, and to what the far
    field says: the gradient of the solution of a Poisson equation with the normals, as they are
    now, on its right-hand side.
    """
    linked = LinkedPatches(patches, links)
    evidence = hear_sensor(patches, spacing, zero, sensor)
    followed = None
    if evidence is None:
        evidence, followed = _weigh_hypotheses(patches, linked, spacing)
    elif not evidence.is_sensed:
        followed = _follow(linked, evidence)
    sides = _settle(patches, linked, spacing, evidence, followed)
    values = (evidence.certainty * np.clip(sides, -1.0, 1.0)).astype(np.float32)
    is_unsure = (np.abs(values) < SURE) & (not evidence.is_sensed)
    doubted = _find_doubted(patches, linked, is_unsure)
    return Orientation(Sides(patches.keys, patches.ranks, values), evidence.how, doubted)


def _find_doubted(
    patches: Patches, linked: LinkedPatches, is_unsure: BoolArray
) -> FloatArray | None:
    """Return the middle of the largest component of some patches; None where there are none."""
    if not is_unsure.any():
        return None
    counts = patches.counts * is_unsure
    numbers = linked.components(is_unsure)
    largest = is_unsure & (numbers == np.argmax(np.bincount(numbers, counts)))
    middle: FloatArray = np.average(patches.centres[largest], axis=0, weights=counts[largest])
    return middle


def _weigh_hypotheses(
    patches: Patches, linked: LinkedPatches, spacing: float
) -> tuple[Evidence, FloatArray]:
    """Return the evidence of the views that contradict themselves least, and what follows of it."""
    outside = look_outside(patches, linked.components(), spacing)
    inside = look_inside(patches, spacing)
    outer, inner = outside.toggled.evidence("from outside"), inside.evidence("from inside")
    content = _share_coherent(patches, linked, outside.is_content)
    is_room = _share_coherent(patches, linked, inside.is_hidden) < _SHOWN * content - _TRIFLE
    if is_room or has_stand(patches, spacing):
        return inner, _follow(linked, inner)
    sides = _follow(linked, outer)
    ground = _face_ground(patches, linked, outside.views, sides)
    if ground is not None:
        return ground
    broken = linked.share_broken(sides)
    if broken > _BROKEN:
        others = _follow(linked, inner)
        if linked.share_broken(others) < _BETTER * broken:
            return inner, others
    # A flat tangle may be a forest, which hides its ground from wherever nobody was.
    is_tangle = broken > _TANGLED and _is_flat(patches, 2)
    if is_tangle or share_of(patches, outside.is_content) > _HIDING:
        outer = replace(outer, certainty=_GUESSED, how="from outside, maybe")
    return outer, sides


def _is_flat(patches: Patches, axis: int) -> bool:
    size = np.ptp(patches.centres, axis=0)
    return bool(size[axis] < _FLAT * size.max())


def _share_coherent(patches: Patches, linked: LinkedPatches, chosen: BoolArray) -> float:
    """Return the share of the area of some patches, but for those that lie about."""
    numbers = linked.components(chosen)
    held = np.bincount(numbers, chosen)[numbers]
    return share_of(patches, chosen & (held >= _FEWEST))


def _face_ground(
    patches: Patches, linked: LinkedPatches, outside: Views, sides: FloatArray
) -> tuple[Evidence, FloatArray] | None:
    """Return the evidence that a flat sheet faces up, and what follows; None of anything else."""
    areas = areas_of(patches)
    areas /= areas.sum()
    front, back = outside.front, outside.back
    excess = float((areas * np.where(sides < 0.0, back - front, front - back)).sum())
    axis = 2 if _is_flat(patches, 2) else int(np.argmin(np.ptp(patches.centres, axis=0)))
    if not _is_flat(patches, axis) or excess > _CONVEX / 8.0:  # an eighth is the most there is
        return None
    if share_of(patches, outside.is_alike) < _OPEN:
        return None
    up = face_along(patches, axis, 1.0, "from above", is_sensed=False)
    upwards = _follow(linked, up)
    if linked.share_broken(upwards) > _TWICE * linked.share_broken(sides) + _BROKEN:
        return None
    facing = np.sign(upwards) * patches.normals[:, axis]
    if float((areas * facing).sum()) < _LEVEL * float((areas * np.abs(facing)).sum()):
        return None
    if axis != 2:  # nobody knows which way is up
        up = replace(up, certainty=_GUESSED, how=f"along {'xyz'[axis]}, maybe")
    return up, upwards


def _follow(linked: LinkedPatches, evidence: Evidence) -> FloatArray:
    """Return the sides that links have where evidence counts next to nothing."""
    weights = _HINT * evidence.weights
    return linked.spread(weights, evidence.leanings, np.zeros(len(weights)))


def _settle(
    patches: Patches,
    linked: LinkedPatches,
    spacing: float,
    evidence: Evidence,
    followed: FloatArray | None,
) -> FloatArray:
    """Return the sides that evidence, links and far field agree on.

    `followed` are those that follow of evidence by links; None where a ray has told, which the far
    field does not contradict.
    """
    weights, leanings = evidence.weights, evidence.leanings
    if followed is None:
        sides = linked.spread(_LEAN * weights, leanings, np.zeros(len(patches)))
        asked = 1.0 - weights
    else:
        weights = np.where(followed * leanings > 0.0, weights, 0.0)
        reached = np.abs(followed[followed != 0.0])  # links may lead to a few patches alone
        sides = followed / (2.0 * float(np.median(reached))) if len(reached) else followed
        asked = np.ones(len(patches))
    total = weights + asked
    for _ in range(_ROUNDS):
        signs = np.where(sides < 0.0, -1.0, 1.0)
        field = _ask_field(patches, np.clip(2.0 * sides, -1.0, 1.0), spacing)
        sides = linked.spread(_LEAN * total, (weights * leanings + asked * field) / total, sides)
        changed = np.count_nonzero(signs != np.where(sides < 0.0, -1.0, 1.0))
        if changed <= _SETTLED * len(patches):
            break
    return sides


def _ask_field(patches: Patches, sides: FloatArray, spacing: float) -> FloatArray:
    """Return how far the far field of the patches agrees with the normal of each: -1 to 1."""
    low, high = patches.centres.min(axis=0), patches.centres.max(axis=0)
    extent = max(float((high - low).max()), CELL * spacing)  # of one patch, its own
    step = _PADDING * extent / _NODES
    origin = 0.5 * (low + high) - 0.5 * step * _NODES
    places = (patches.centres - origin) / step
    areas = areas_of(patches) * (CELL * spacing / step) ** 2
    held = _held_rows((low - origin) / step, (high - origin) / step)
    values = np.zeros((_NODES,) * 3, np.float32)
    values[tuple(slice(*bounds) for bounds in held)] = integrate_normals(
        places, patches.normals * (sides * areas)[:, None], 1.0, held, _NODES
    )
    rise = sample_grid(values, places + patches.normals)
    rise -= sample_grid(values, places - patches.normals)
    agreement: FloatArray = np.clip(rise / max(float(np.median(np.abs(rise))), 1e-300), -1.0, 1.0)
    return agreement


def _held_rows(low: FloatArray, high: FloatArray) -> IntArray:
    """Return the first and the end of the planes and of the rows that hold a box and two nodes."""
    first = np.maximum(np.floor(low).astype(np.int64) - 2, 0)
    end = np.minimum(np.ceil(high).astype(np.int64) + 3, _NODES)
    return np.stack([first, end], axis=1)[:2]
