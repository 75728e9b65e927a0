"""Integer places on a lattice: cells, their corners, parents, and how to look them up.

A place is a triple of integers, packed into one int64 key; sorted keys are the only index.
Level l of the pyramid has cells of edge s * 2^l; cell i spans the corners i and i + 1, its parent
is cell i >> 1, and corner i of one level is corner i / 2 of the next where i is even.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpccomponent.errors import InputError

KeyT = TypeVar("KeyT", np.int64, np.int32)

BITS = 21
"""Of each coordinate in a key, x the highest."""

_BIAS = 1 << (BITS - 1)
_MASK = (1 << BITS) - 1
_STRIDES = (1 << 2 * BITS, 1 << BITS, 1)

# Cells along each axis, powers of the golden ratio: far from simple fractions, and unlike.
_OFFSETS: FloatArray = np.array([0.3819660112501051, 0.2360679774997897, 0.1458980337503155])

OCTANTS: IntArray = np.array([(o & 1, o >> 1 & 1, o >> 2 & 1) for o in range(8)], np.int64)
"""The eight corners of the unit cube, x fastest."""


def pack_places(places: IntArray) -> IntArray:
    """Pack integer triples (..., 3), each within +-2^20, into keys (...) that sort like them.

    Raise InputError where a coordinate is out of range.

    Examples
    --------
    >>> place = np.array([[-3, 0, 7]])
    >>> unpack_keys(pack_places(place)).tolist()
    [[-3, 0, 7]]
    """
    if places.size and max(-int(places.min()), int(places.max()) + 1) > _BIAS:
        raise InputError(
            f"the cloud spans more than {_BIAS} cells of the lattice",
            "remove far outliers, or ask for less detail",
        )
    biased = places + _BIAS
    keys: IntArray = biased[..., 0] * _STRIDES[0] + biased[..., 1] * _STRIDES[1] + biased[..., 2]
    return keys


def unpack_keys(keys: IntArray) -> IntArray:
    """Return the integer triples of packed keys, of shape (..., 3)."""
    parts = [(keys >> shift & _MASK) - _BIAS for shift in (2 * BITS, BITS, 0)]
    return np.stack(parts, axis=-1)


def keys_lie_within(keys: IntArray, first: IntArray, last: IntArray) -> bool:
    """Tell whether all keys are of places between the lowest, (3,), and the highest one, (3,)."""
    for axis, shift in enumerate((2 * BITS, BITS, 0)):
        biased = keys >> shift & _MASK  # one axis at a time: there may be many keys
        low, high = first[axis] + _BIAS, last[axis] + _BIAS
        if len(keys) and not (biased.min() >= low and biased.max() <= high):
            return False
    return True


def shift_within(places: FloatArray, step: int) -> IntArray:
    """Return places (..., 3) `step` further on along each axis, or the last ones with a key.

    They are whole numbers, and may lie beyond.
    """
    return np.clip(places + step, -_BIAS, _BIAS - 1).astype(np.int64)


def ancestor_keys(keys: IntArray, levels: int = 1) -> IntArray:
    """Return the key of the cell, so many levels (0 to 20) further up, that each cell lies in.

    Examples
    --------
    >>> unpack_keys(ancestor_keys(pack_places(np.array([[-3, 0, 7]])))).tolist()
    [[-2, 0, 3]]
    """
    whole = sum(_STRIDES)
    ancestors = keys >> levels
    ancestors &= (_MASK >> levels) * whole  # what has come from the next coordinate goes
    ancestors += (_BIAS - (_BIAS >> levels)) * whole
    return ancestors


def are_sampled(keys: IntArray, one_in: int) -> BoolArray:
    """Tell which keys are in a sample of about one in `one_in`, chosen by a hash of each."""
    if one_in == 1:
        return np.ones(len(keys), np.bool_)
    mixed = (keys.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(33)
    chosen: BoolArray = (mixed * np.uint64(one_in)) >> np.uint64(31) == 0
    return chosen


def shuffle_keys(keys: IntArray) -> IntArray:
    """Return another key for each, which tells nothing of where it lies.

    Of a regular lattice `are_sampled` leaves planes; of shuffled keys it leaves no pattern.
    """
    mixed = keys.view(np.uint64)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        mixed = (mixed ^ (mixed >> np.uint64(shift))) * np.uint64(factor)
    shuffled: IntArray = (mixed ^ (mixed >> np.uint64(31))).view(np.int64)
    return shuffled


def step_keys(keys: IntArray, step: IntArray) -> IntArray:
    """Return the keys of the places `step` further on."""
    return keys + int(np.dot(step, _STRIDES))


def find_first(keys: IntArray) -> tuple[IntArray, IntArray]:
    """Return the different keys, sorted, and the row where each is first.

    Examples
    --------
    >>> [array.tolist() for array in find_first(np.array([7, 3, 7, 3]))]
    [[3, 7], [1, 0]]
    """
    order, ordered, begins = _order(keys)
    return ordered[begins], order[begins]


def find_keys(keys: IntArray, wanted: IntArray) -> IntArray:
    """Return the row of each wanted key among k sorted, unique keys; k where it is missing."""
    rows = np.searchsorted(keys, wanted)
    if not len(keys):
        return rows
    is_there = keys[np.minimum(rows, len(keys) - 1)] == wanted
    return np.where(is_there, rows, len(keys))


def find_layers(keys: IntArray, first: int, last: int) -> slice:
    """Return the run of sorted keys whose x is from the first to the last one, both included.

    Examples
    --------
    >>> keys = pack_places(np.array([[-1, 5, 0], [2, -7, 1], [2, 3, 0], [4, 0, 0]]))
    >>> find_layers(keys, 0, 3)
    slice(1, 3, None)
    """
    bounds = (np.array([first, last + 1]) + _BIAS) * _STRIDES[0]
    start, stop = np.searchsorted(keys, bounds)
    return slice(int(start), int(stop))


def find_within(keys: IntArray, first: IntArray, last: IntArray) -> IntArray:
    """Return the rows of the sorted keys between the lowest place, (3,), and the highest one, (3,).

    Examples
    --------
    >>> keys = pack_places(np.array([[-1, 5, 0], [2, -7, 1], [2, 3, 0], [4, 0, 0]]))
    >>> find_within(keys, np.array([0, -9, 0]), np.array([4, 0, 1])).tolist()
    [1, 3]
    """
    run = find_layers(keys, int(first[0]), int(last[0]))
    places = unpack_keys(keys[run])[:, 1:]
    is_within = ((places >= first[1:]) & (places <= last[1:])).all(axis=1)
    rows: IntArray = run.start + np.flatnonzero(is_within)
    return rows


def merge_counts(keys: IntArray, counts: IntArray) -> tuple[IntArray, IntArray]:
    """Return the different keys, sorted, and the sum of each one's counts, or rows of these."""
    order, ordered, begins = _order(keys)
    sums = np.add.reduceat(counts[order], np.flatnonzero(begins), axis=0, dtype=np.int64)
    return ordered[begins], sums


def unique_keys(keys: NDArray[KeyT]) -> NDArray[KeyT]:
    """Return the keys, sorted, each once.

    Sorting keys is several times faster than the hash table of `numpy.unique`, whose first call
    imports masked arrays besides. Most keys come in sorted runs, which the stable sort merges four
    times faster than the other one sorts them; on keys in no order it is a third slower.
    """
    ordered = np.sort(keys, kind="stable")
    return ordered[_begins(ordered)]


def _order(
    keys: NDArray[KeyT],
) -> tuple[IntArray, NDArray[KeyT], BoolArray]:
    """Return how to sort keys, the same ones in place; the sorted keys; see `_begins`."""
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    return order, ordered, _begins(ordered)


def _begins(ordered: NDArray[KeyT]) -> BoolArray:
    """Tell which of some sorted keys are not the one before them."""
    first = np.empty(len(ordered), np.bool_)
    first[:1] = True
    np.not_equal(ordered[1:], ordered[:-1], out=first[1:])
    return first


def number_keys(keys: NDArray[KeyT]) -> tuple[NDArray[KeyT], IntArray]:
    """Return the different keys, sorted, and where among them each key stands.

    Examples
    --------
    >>> [array.tolist() for array in number_keys(np.array([7, 3, 7]))]
    [[3, 7], [1, 0, 1]]
    """
    order, ordered, begins = _order(keys)
    numbers = np.empty(len(keys), np.int64)
    numbers[order] = np.cumsum(begins) - 1
    return ordered[begins], numbers


def unite_keys(first: IntArray, second: IntArray) -> IntArray:
    """Return the union of two sets of keys; all are sorted and unique."""
    return unique_keys(np.concatenate([first, second]))


def spread_keys(keys: IntArray, low: int, high: int) -> IntArray:
    """Return the places within the box [low, high]^3 around each place, sorted, each once.

    (0, 1) turns cells into their corners, (-1, 2) into those of the cells and their neighbours.
    """
    for stride in _STRIDES[::-1]:
        # One axis at a time: the intermediate sets stay a few times the input's size.
        keys = unique_keys(np.concatenate([keys + step * stride for step in range(low, high + 1)]))
    return keys


def corner_parents(places: IntArray, octant: IntArray) -> tuple[IntArray, IntArray]:
    """Return one of the eight parents of corners (v, 3), as keys (v,), and steps (v, 3) from it.

    The octant (3,) says which; the two parents along an axis with an even coordinate are the same.
    Steps are in cells of the finer level: -1, 0 or 1.
    """
    parents = (places + octant) >> 1
    return pack_places(parents), places - 2 * parents


def lay_lattice(low: FloatArray, cell_size: float) -> FloatArray:
    """Return where corner (0, 0, 0) of the lattice over a cloud lies: a little below `low` (3,).

    What comes of a cloud must not hang on the last bits of its least coordinates. A lattice from
    `low` on would have points on the faces of its cells: the outermost ones, and those of clouds
    that are regular themselves.
    """
    return low - _OFFSETS * cell_size


def cells_of(positions: FloatArray, origin: FloatArray, cell_size: float) -> FloatArray:
    """Return positions (n, 3) in cells of a lattice whose corner (0, 0, 0) is the origin.

    The integer part names the cell.
    """
    return (positions - origin) / cell_size


def find_overlapping(
    keys: IntArray, origin: FloatArray, size: float, other_origin: FloatArray, other_size: float
) -> IntArray:
    """Return the cells of another lattice that some cells overlap: sorted, unique keys.

    Each lattice has its corner (0, 0, 0) at its origin (3,), and cells with edges of its size.
    """
    corner = origin + size * unpack_keys(keys) - other_origin
    first = np.floor(corner / other_size).astype(np.int64)
    # (k, 3): how many steps from the first to the last that each overlaps; all between are taken.
    steps = np.floor((corner + size) / other_size).astype(np.int64) - first
    lowest, found = pack_places(first), []
    for step in np.ndindex(*(steps.max(axis=0, initial=0) + 1)):
        reached = np.logical_and.reduce(
            [most >= at for most, at in zip(steps.T, step, strict=True)]
        )
        found.append(unique_keys(step_keys(lowest[reached], np.array(step))))
    return unique_keys(np.concatenate(found))


NEIGHBOURS: IntArray = np.array(
    [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], np.int64
)
"""Steps to the 27 cells of a neighbourhood, the cell itself included, in the order of the keys."""
