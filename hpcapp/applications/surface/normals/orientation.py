"""The side of every patch, over the whole object at once.

::

    evidence ── where links agree ──┐
    far field of the signed normals ┴─> leanings of patches ── spread over links ──> sides
                    └────────────────────── until none changes ────────────────────────┘
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hpcapp.applications.surface.normals.evidence.linked import LinkedPatches
from hpcapp.applications.surface.normals.evidence.readings import (
    Followed,
    Hypothesis,
    follow,
    weigh_given,
    weigh_readings,
)
from hpcapp.applications.surface.normals.evidence.seen_sides import Evidence, areas_of, hear_user
from hpcapp.applications.surface.normals.patches import CELL, Links, Patches, Sides
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.applications.surface.types import reading
from hpcapp.applications.surface.types.reading import Measurement
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.kernels import integrate_normals, sample_grid
from hpccomponent.dataclass import dataclass

SURE = 0.3
"""Confidence of a side of the probability `reading.SURE`; it grows with the logarithm of odds."""
_ODDS = float(np.log(reading.SURE / (1.0 - reading.SURE))) / SURE

_LEAN = 0.3  # how strongly all that is known of a patch counts beside its links
_LEAST = 0.01  # confidence of a side that two readings explain alike
_NODES = 128
_PADDING = 1.3
_ROUNDS = 12
_SETTLED = 1e-3  # share of patches that still change sides


@dataclass(frozen=True, slots=True)
class ScanVerdict:
    """How a scan was seen; for the kinds see `types.reading.Reading`.

    The `certainty` is its probability, 0 to 1, with all readings that give the same sides; `rivals`
    are other readings with theirs, the likeliest first.
    """

    kind: str
    certainty: float = 1.0
    rivals: tuple[tuple[str, float], ...] = ()
    because: tuple[Measurement, ...] = ()

    @classmethod
    def of(cls, weighed: Sequence[Followed], certainty: float) -> ScanVerdict:
        """Return it by what was weighed, of which the first is believed."""
        best, *others = weighed
        others = sorted(others, key=lambda one: -one.share)[:3]
        rivals = tuple((one.hypothesis.name, one.share) for one in others)
        because = Measurement("cost of the reading", best.features.cost, "of the area")
        return cls(best.hypothesis.name, certainty, rivals, (because,))


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """What is unsure of the sides, and what was believed.

    `middle`, (3,), is that of the largest piece whose side is unsure, in the frame of the patches;
    `rival` what would most probably turn it round, None where nothing that was weighed would.
    """

    middle: FloatArray
    reading: Hypothesis
    rival: Hypothesis | None


@dataclass(frozen=True, slots=True, eq=False)
class Orientation:
    """The sides of the patches of a cloud, and where the evidence comes from, for people (`how`).

    `doubt` is None where a user has told: nothing more can be told. `verdict` is None where a user
    has told places, among the points or around them.
    """

    sides: Sides
    how: str
    doubt: Doubt | None
    verdict: ScanVerdict | None


def orient_patches(
    patches: Patches,
    links: Links,
    spacing: float,
    zero: FloatArray,
    sensor: Sensor,
    threads: int = 1,
) -> Orientation:
    """Find the side of each patch of a whole cloud.

    `zero`, (3,), is where the input has (0, 0, 0), in the frame of the patches. InputError where
    the sensor was inside, and no place inside is found.

    Notes
    -----
    A ray went to every point. Where it came from is evidence, and links and the far field fill in.
    Where no user tells, the reading is taken whose sides are most probable (see `readings`), and a
    patch is as sure as the readings that agree on its side are probable.

    Views show the inside of an object, too, where a part of it was not scanned. So the evidence
    is spread over links first, in which it counts next to nothing, and what contradicts the
    result is left out. Then the sides are drawn to what the rest of it says, and to what the far
    field says: the gradient of the solution of a Poisson equation with the normals, as they are
    now, on its right-hand side.
    """
    linked = LinkedPatches(patches, links)
    if sensor.is_told and sensor.kind != "unknown":
        evidence = hear_user(patches, linked.components(), spacing, zero, sensor, threads)
        followed = None if evidence.is_sensed else follow(linked, evidence)
        sides = _settle(patches, linked, spacing, evidence, followed, threads)
        values = np.clip(sides, -1.0, 1.0).astype(np.float32)
        told = None if sensor.kind == "places" else ScanVerdict(sensor.kind)
        return Orientation(Sides(patches.keys, patches.ranks, values), evidence.how, None, told)
    weighed = weigh_readings(patches, linked, spacing, zero, sensor, threads)
    best, evidence = weighed[0], weighed[0].hypothesis.evidence
    followed = None if evidence.is_sensed else best.sides
    sides = _settle(patches, linked, spacing, evidence, followed, threads)
    # (r, p): whether a reading turns a patch round; the first one is what it was settled from.
    turns = np.array([one.sides * sides < 0.0 for one in weighed])
    turns[0] = False
    # (p,): the probability that a side is right.
    right = (np.array([[one.share] for one in weighed]) * ~turns).sum(axis=0)
    odds = np.log(right / np.maximum(1.0 - right, 1e-9))
    certainty = np.clip(odds / _ODDS, _LEAST, 1.0)  # above 0, or the sides would be lost
    # Rays tell a side whatever its neighbours say of it.
    leant: FloatArray = np.copysign(certainty, sides) if evidence.is_sensed else sides
    values = np.clip(leant, -certainty, certainty).astype(np.float32)
    doubt = _find_doubt(patches, linked, np.abs(values) < SURE, weighed, turns)
    verdict = ScanVerdict.of(weighed, float(np.average(right, weights=areas_of(patches))))
    return Orientation(Sides(patches.keys, patches.ranks, values), evidence.how, doubt, verdict)


def read_given(
    patches: Patches, spacing: float, zero: FloatArray, sensor: Sensor, threads: int = 1
) -> ScanVerdict:
    """Tell how a scan was seen whose patches have their sides; as for `orient_patches`."""
    if sensor.is_told and sensor.kind not in ("unknown", "places"):
        return ScanVerdict(sensor.kind)
    weighed = weigh_given(patches, spacing, zero, sensor, threads)
    name = weighed[0].hypothesis.name
    return ScanVerdict.of(weighed, sum(one.share for one in weighed if one.hypothesis.name == name))


def _find_doubt(
    patches: Patches,
    linked: LinkedPatches,
    is_unsure: BoolArray,
    weighed: list[Followed],
    turns: BoolArray,
) -> Doubt | None:
    """Return what is unsure of some patches; None where there are none."""
    if not is_unsure.any():
        return None
    counts = patches.counts * is_unsure
    # The largest piece is the one with the most points, of unsure patches that hang together.
    numbers = linked.components(is_unsure)
    largest = is_unsure & (numbers == np.argmax(np.bincount(numbers, counts)))
    middle: FloatArray = np.average(patches.centres[largest], axis=0, weights=counts[largest])
    # (r,): by points that are turned round, and by how probable the reading is.
    shares = np.array([one.share for one in weighed])
    rivals = shares * (turns @ (patches.counts * largest))
    rival = weighed[int(np.argmax(rivals))].hypothesis if rivals.any() else None
    return Doubt(middle, weighed[0].hypothesis, rival)


def _settle(
    patches: Patches,
    linked: LinkedPatches,
    spacing: float,
    evidence: Evidence,
    followed: FloatArray | None,
    threads: int,
) -> FloatArray:
    """Return the sides that evidence, links and far field agree on.

    `followed` are those that follow of evidence by links; None where a ray has told, which the
    far field does not contradict.
    """
    weights, leanings = evidence.weights, evidence.leanings
    if followed is None:
        sides = linked.spread(_LEAN * weights, leanings, np.zeros(len(patches)))
        # (p,): the far field has its say as far as the sensor has told nothing.
        asked = 1.0 - weights
    else:
        # (p,): views that contradict what follows of all of them may have seen the inside.
        weights = np.where(followed * leanings > 0.0, weights, 0.0)
        # (p,): scaled so that the median patch is at 0.5, where it counts fully in the field.
        reached = np.abs(followed[followed != 0.0])  # links may lead to a few patches alone
        sides = followed / (2.0 * float(np.median(reached))) if len(reached) else followed
        asked = np.ones(len(patches))
    total = weights + asked
    for _ in range(_ROUNDS):
        # The field depends on the sides, and these on the field: both in turn until they settle.
        signs = np.where(sides < 0.0, -1.0, 1.0)
        field = _ask_field(patches, np.clip(2.0 * sides, -1.0, 1.0), spacing, threads)
        sides = linked.spread(_LEAN * total, (weights * leanings + asked * field) / total, sides)
        changed = np.count_nonzero(signs != np.where(sides < 0.0, -1.0, 1.0))
        if changed <= _SETTLED * len(patches):
            break
    return sides


def _ask_field(patches: Patches, sides: FloatArray, spacing: float, threads: int) -> FloatArray:
    """Return how far the far field of the patches agrees with the normal of each: -1 to 1."""
    low, high = patches.centres.min(axis=0), patches.centres.max(axis=0)
    extent = max(float((high - low).max()), CELL * spacing)  # of one patch, its own
    # A cube of nodes with the cloud in its middle, wider than that on all sides.
    step = _PADDING * extent / _NODES
    origin = 0.5 * (low + high) - 0.5 * step * _NODES
    places = (patches.centres - origin) / step
    # (p,): in squares of the grid's step, the unit that `places` are in.
    areas = areas_of(patches) * (CELL * spacing / step) ** 2
    # (2, 2): the planes and rows that are sampled below; no others are computed.
    held = _held_rows((low - origin) / step, (high - origin) / step)
    values = np.zeros((_NODES,) * 3, np.float32)
    values[tuple(slice(*bounds) for bounds in held)] = integrate_normals(
        places, patches.normals * (sides * areas)[:, None], 1.0, held, _NODES, threads
    )
    # (p,): the field one step before each patch less the field one step behind it. It rises along
    # normals that fit in with the others.
    rise = sample_grid(values, places + patches.normals)
    rise -= sample_grid(values, places - patches.normals)
    # (p,): in median rises, as the field has no unit of its own.
    agreement: FloatArray = np.clip(rise / max(float(np.median(np.abs(rise))), 1e-300), -1.0, 1.0)
    return agreement


def _held_rows(low: FloatArray, high: FloatArray) -> IntArray:
    """Return the first and the end of the planes and of the rows that hold a box and two nodes."""
    first = np.maximum(np.floor(low).astype(np.int64) - 2, 0)
    end = np.minimum(np.ceil(high).astype(np.int64) + 3, _NODES)
    return np.stack([first, end], axis=1)[:2]
