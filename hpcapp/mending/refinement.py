"""A patch with triangles as large as those around its hole, and as well shaped.

Triangles are divided at their middles while they are larger than those at the border, and edges are
flipped to the shorter diagonal in between (Liepa 2003, https://doi.org/10.2312/SGP/SGP03/200-206).
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.lattice import find_first, find_keys, unique_keys
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray

_MOST_VERTICES = 20_000
"""Of a patch, about: in a larger hole triangles grow towards the middle, as nothing is known of
what was there."""
_ROUNDS = 40  # of divisions, and of flips after each
_EVEN = -1e-6  # sum of two cotangents: below it the other diagonal is better


def refine(
    places: FloatArray, faces: IntArray, sides: FloatArray, taken: IntArray
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Divide the triangles of a patch until they are as large as those around it.

    Places (n, 3) are the vertices of the loop around it, and those within; edges are to be as long
    as the sides (n,) at their vertices; edges of the mesh join the vertices that are taken, (t, 2),
    the lower first. Return places, faces and sides; new vertices are behind the others.
    """
    area = 0.5 * float(np.linalg.norm(cross_edges(places[faces]), axis=1).sum())
    coarse = np.sqrt(area / _MOST_VERTICES)
    for _ in range(_ROUNDS):
        faces = relax(places, faces, taken)
        middles = places[faces].mean(axis=1)
        lengths = np.maximum(sides[faces].mean(axis=1), coarse)
        arms = np.linalg.norm(places[faces] - middles[:, None], axis=2)
        is_large = (np.sqrt(2.0) * arms > np.maximum(lengths[:, None], sides[faces])).all(axis=1)
        if not is_large.any():
            break
        new = len(places) + np.arange(int(is_large.sum()))
        a, b, c = faces[is_large].T
        divided = [np.stack(corners, axis=1) for corners in ((a, b, new), (b, c, new), (c, a, new))]
        faces = np.concatenate([faces[~is_large], *divided])
        places = np.concatenate([places, middles[is_large]])
        sides = np.concatenate([sides, lengths[is_large]])
    return places, faces, sides


def relax(places: FloatArray, faces: IntArray, taken: IntArray) -> IntArray:
    """Flip edges of a patch until each is the better diagonal; return the faces.

    No flip makes an edge that is there already, or turns a face round.
    """
    held = unique_keys(taken[:, 0] * len(places) + taken[:, 1])
    for _ in range(_ROUNDS):
        flipped = _flip(places, faces, held)
        if flipped is None:
            break
        faces = flipped
    return faces


def _flip(places: FloatArray, faces: IntArray, held: IntArray) -> IntArray | None:
    """Flip edges that share no face; None where all are as they should be."""
    count = len(places)
    tails, heads = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    tips = np.roll(faces, -2, axis=1).reshape(-1)
    keys = np.minimum(tails, heads) * count + np.maximum(tails, heads)
    order = np.argsort(keys, kind="stable")
    pairs = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    # (e,): both sides of each edge within the patch.
    one, other = order[pairs], order[pairs + 1]
    a, b, c, d = tails[one], heads[one], tips[one], tips[other]
    sums = _cotangent(places, c, a, b) + _cotangent(places, d, a, b)
    new = np.minimum(c, d) * count + np.maximum(c, d)
    is_bad = (sums < _EVEN) & ~_is_in(np.union1d(held, unique_keys(keys)), new) & (c != d)
    is_bad &= _stays_upright(places, a, b, c, d)
    if not is_bad.any():
        return None
    # Of the edges of a face the worst is flipped; of edges that would become one, the first.
    chosen = np.flatnonzero(is_bad)
    chosen = chosen[np.sort(find_first(new[chosen])[1])]
    worst = np.full(len(faces), np.inf)
    sides = np.stack([one[chosen] // 3, other[chosen] // 3])
    # No two edges are as bad as each other, so that each round flips one at least.
    rank = np.empty(len(chosen))
    rank[np.argsort(sums[chosen], kind="stable")] = np.arange(len(chosen))
    for side in sides:
        np.minimum.at(worst, side, rank)
    flips = (worst[sides] == rank).all(axis=0)
    a, b, c, d = (ends[chosen[flips]] for ends in (a, b, c, d))
    turned = faces.copy()
    turned[sides[0, flips]] = np.stack([a, d, c], axis=1)
    turned[sides[1, flips]] = np.stack([d, b, c], axis=1)
    return turned


def _is_in(keys: IntArray, wanted: IntArray) -> BoolArray:
    return find_keys(keys, wanted) < len(keys)


def _cotangent(places: FloatArray, tip: IntArray, one: IntArray, other: IntArray) -> FloatArray:
    """Return the cotangents of angles at tips."""
    first, second = places[one] - places[tip], places[other] - places[tip]
    across = np.linalg.norm(np.cross(first, second), axis=1)
    along = np.einsum("ij,ij->i", first, second)
    cotangents: FloatArray = along / np.maximum(across, 1e-12 * np.abs(along) + 1e-300)
    return cotangents


def _stays_upright(
    places: FloatArray, a: IntArray, b: IntArray, c: IntArray, d: IntArray
) -> BoolArray:
    """Tell for which edges both faces behind a flip look as the two before do together."""

    def normal(*corners: IntArray) -> FloatArray:
        return cross_edges(places[np.stack(corners, axis=1)])

    before = normal(a, b, c) + normal(b, a, d)
    behind = (normal(a, d, c), normal(d, b, c))
    is_upright: BoolArray = np.logical_and.reduce(
        [np.einsum("ij,ij->i", before, each) > 0.0 for each in behind]
    )
    return is_upright
