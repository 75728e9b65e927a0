"""The side of every patch, over the whole object at once.

::

    evidence ── where links agree ──┐
    far field of the signed normals ┴─> leanings of patches ── spread over links ──> sides
                    └────────────────────── until none changes ────────────────────────┘
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.kernels import integrate_normals, sample_grid
from hpcapp.applications.surface.normals.evidence import Evidence, areas_of, hear_sensor
from hpcapp.applications.surface.normals.linked import LinkedPatches
from hpcapp.applications.surface.normals.patches import CELL, Links, Patches, Sides
from hpcapp.applications.surface.normals.readings import (
    CERTAIN,
    Followed,
    Reading,
    find_readings,
    follow,
    weigh_readings,
)
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.applications.surface.types.reading import Measurement
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpccomponent.dataclass import dataclass

SURE = 0.3
"""From this confidence on the side of a patch counts as sure."""

_LEAN = 0.3  # how strongly all that is known of a patch counts beside its links
_TANGLED = 0.07  # links that a flat sheet may break
_FLAT = 0.6  # height of what may be a forest, in longest sides
_MOST = 0.15  # cost of a reading that explains what there is
_LEAST = 0.01  # certainty of a side that two readings explain alike
_GUESSED = 0.25  # certainty of a side that no reading explains
_NODES = 128
_PADDING = 1.3
_ROUNDS = 12
_SETTLED = 1e-3  # share of patches that still change sides
_SOFT = CERTAIN / 3.0  # cost by which a reading is e times as likely as another one


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a scan was seen.

    Parameters
    ----------
    kind : str
        See `types.reading.Reading`.
    certainty : float
        Its probability, 0 to 1.
    rivals : tuple of (str, float)
        Other kinds, and the probability of each; the likeliest first.
    because : tuple of Measurement
    """

    kind: str
    certainty: float = 1.0
    rivals: tuple[tuple[str, float], ...] = ()
    because: tuple[Measurement, ...] = ()

    @classmethod
    def of(cls, kinds: list[str], costs: list[float], best: int) -> Verdict:
        """Return it by what each kind costs, and which of them is believed."""
        likely = np.exp((min(costs) - np.array(costs)) / _SOFT)
        likely /= likely.sum()
        rivals = sorted(
            ((kinds[row], float(likely[row])) for row in range(len(kinds)) if row != best),
            key=lambda rival: -rival[1],
        )
        because = (Measurement("cost of the reading", costs[best], "of the area"),)
        return cls(kinds[best], float(likely[best]), tuple(rivals[:3]), because)


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """What is unsure of the sides.

    Parameters
    ----------
    middle : ndarray of float64, shape (3,)
        Of the largest piece whose side is unsure, in the frame of the patches.
    reading : Reading
        What was believed.
    rival : Reading or None
        What would turn that piece round; None where no reading explains it.
    """

    middle: FloatArray
    reading: Reading
    rival: Reading | None


@dataclass(frozen=True, slots=True, eq=False)
class Orientation:
    """The sides of the patches of a cloud.

    Parameters
    ----------
    sides : Sides
    how : str
        Where the evidence comes from, for people.
    doubt : Doubt or None
        Where a sensor has told, nothing more can be told.
    verdict : Verdict or None
        None where places have told, among the points or around them.
    """

    sides: Sides
    how: str
    doubt: Doubt | None
    verdict: Verdict | None


def orient_patches(
    patches: Patches,
    links: Links,
    spacing: float,
    zero: FloatArray,
    sensor: Sensor,
    threads: int = 1,
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

    Raises
    ------
    InputError
        It was inside, and no place inside is found.

    Notes
    -----
    A ray went to every point. Where it came from is evidence, and links and the far field fill in.
    Where nobody knows, the reading that costs least is taken (see `readings`), and a patch is as
    sure as the best reading that would turn it round costs more.

    Views show the inside of an object, too, where a part of it was not scanned. So the evidence
    is spread over links first, in which it counts next to nothing, and what contradicts the
    result is left out. Then the sides are drawn to what the rest of it says, and to what the far
    field says: the gradient of the solution of a Poisson equation with the normals, as they are
    now, on its right-hand side.
    """
    linked = LinkedPatches(patches, links)
    evidence = hear_sensor(patches, linked.components(), spacing, zero, sensor, threads)
    if evidence is not None:
        followed = None if evidence.is_sensed else follow(linked, evidence)
        sides = _settle(patches, linked, spacing, evidence, followed, threads)
        values = np.clip(sides, -1.0, 1.0).astype(np.float32)
        told = None if sensor.kind == "places" else Verdict(sensor.kind)
        return Orientation(Sides(patches.keys, patches.ranks, values), evidence.how, None, told)
    best, *others = weigh_readings(patches, linked, spacing, zero, threads)
    sides = _settle(patches, linked, spacing, best.reading.evidence, best.sides, threads)
    # (r, p): how much more a reading costs that turns the patch round; the first row is the best
    # reading's own, which turns none.
    margins = np.full((1 + len(others), len(patches)), CERTAIN)
    for margin, other in zip(margins[1:], others, strict=True):
        margin[other.sides * sides < 0.0] = max(other.cost - best.cost, 0.0)
    # (p,): the cheapest reading that contradicts decides. Above 0, or the sides would be lost.
    certainty = np.maximum(margins.min(axis=0) / CERTAIN, _LEAST)
    if _is_tangled(patches, linked, best):
        certainty = np.minimum(certainty, _GUESSED)
    values = np.clip(sides, -certainty, certainty).astype(np.float32)
    doubt = _find_doubt(patches, linked, np.abs(values) < SURE, best, others, margins)
    oriented = Sides(patches.keys, patches.ranks, values)
    weighed = [best, *others]
    costs = [one.cost + (one.reading.habit or 0.0) for one in weighed]
    verdict = Verdict.of([one.reading.kind for one in weighed], costs, 0)
    return Orientation(oriented, best.reading.evidence.how, doubt, verdict)


def read_given(
    patches: Patches, spacing: float, zero: FloatArray, sensor: Sensor, threads: int = 1
) -> Verdict:
    """Tell how a scan was seen whose patches have their sides; as for `orient_patches`."""
    if sensor.kind not in ("unknown", "places"):
        return Verdict(sensor.kind)
    none = np.empty(0, np.int64)
    linked = LinkedPatches(patches, Links(none, none, none))
    readings = find_readings(patches, linked, spacing, zero, threads)
    is_turned = np.zeros(len(patches), np.bool_)
    costs = [one.cost(patches, is_turned) + (one.habit or 0.0) for one in readings]
    return Verdict.of([one.kind for one in readings], costs, int(np.argmin(costs)))


def _is_tangled(patches: Patches, linked: LinkedPatches, best: Followed) -> bool:
    """Tell whether not even the best reading explains what there is."""
    # A flat tangle may be a forest, which hides its ground from wherever nobody was.
    size = np.ptp(patches.centres, axis=0)
    is_flat = bool(size[2] < _FLAT * size.max())
    return best.cost > _MOST or (is_flat and linked.share_broken(best.sides) > _TANGLED)


def _find_doubt(
    patches: Patches,
    linked: LinkedPatches,
    is_unsure: BoolArray,
    best: Followed,
    others: list[Followed],
    margins: FloatArray,
) -> Doubt | None:
    """Return what is unsure of some patches; None where there are none."""
    if not is_unsure.any():
        return None
    counts = patches.counts * is_unsure
    # The largest piece is the one with the most points, of unsure patches that hang together.
    numbers = linked.components(is_unsure)
    largest = is_unsure & (numbers == np.argmax(np.bincount(numbers, counts)))
    middle: FloatArray = np.average(patches.centres[largest], axis=0, weights=counts[largest])
    # (r - 1,): by points, and by how little more each reading costs that turns them round.
    rivals = (patches.counts * largest * (CERTAIN - margins[1:])).sum(axis=1)
    rival = others[int(np.argmax(rivals))].reading if rivals.any() else None
    return Doubt(middle, best.reading, rival)


def _settle(
    patches: Patches,
    linked: LinkedPatches,
    spacing: float,
    evidence: Evidence,
    followed: FloatArray | None,
    threads: int,
) -> FloatArray:
    """Return the sides that evidence, links and far field agree on.

    `followed` are those that follow of evidence by links; None where a ray has told, which the far
    field does not contradict.
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
