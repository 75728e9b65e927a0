"""Normals that point the wrong way, found by asking the neighbours on the same sheet."""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.lattice import cells_of, number_keys, pack_places
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, IntArray
from hpcapp.kernels import UNSURE, WRONG
from hpccomponent.dataclass import dataclass

FOLLOWING, TORN = 0.975, 0.07
"""Share of the normals that follow a place, and share of the opposite pairs among those across the
line of sight, from which on they follow nothing else."""


_EDGE = 3.0  # of the cells, in spacings: some 28 neighbours lie within
_TOLERANCE = 0.35  # spacings between a sheet and a point that still counts to it
_DRIFT = 0.5  # spacings between a sheet and the mean of those that oppose a normal on it
_FEW = 8  # points, of which none is told
_PAIRS = 8  # of each point, with those after it in its box
_ROUNDS = 3  # each with cells of twice the size, for what the last left open
_FEWEST_JUDGED = 100  # of which it is judged
_SEEKING = 2_000  # points by which it is sought what normals follow
_STEPS = 400  # of the search
_HOPELESS = 60  # after which one that has found little is given up
_ACROSS = 0.08  # cosine between normals that are across the line of sight and that
_FEWEST_TORN = 30  # pairs of these that tell

MARGIN = _EDGE * (2.0**_ROUNDS - 1.0)
"""Spacings: as far as what decides over a normal lies, all rounds together."""


def find_flipped(
    positions: FloatArray,
    normals: FloatArray | Float32Array,
    low: FloatArray,
    spacing: float,
    threads: int = 1,
) -> BoolArray:
    """Find the normals that their neighbours on the same sheet contradict, (n,).

    Positions (n, 3) are of a cloud, or of a region of it and all points within `MARGIN` spacings;
    unit normals (n, 3) tell the same in float32 and float64; `low`, (3,), has the cloud's least
    coordinates. InputError or ValueError where the cloud spans more than 2^20 spacings.

    Notes
    -----
    The neighbours of a point within 3 spacings count to its sheet where the offset between the
    two, along either normal, is at most 0.35 spacings: points of the other side of a thin plate
    do not. A normal is wrong where the neighbours that oppose it (n . m < -0.5) number eight, and
    four more for each that agrees. Where there are two sheets closer than that, both have their
    say and none has the majority. What remains open is asked again at twice and at four times
    the size, where the opponents' mean offset must stay below 0.5 spacings.
    """
    is_flipped = np.zeros(len(positions), np.bool_)
    if len(positions) < _FEW:
        return is_flipped
    asked = np.ones(len(positions), np.uint8)
    mended = normals
    # One side of a plate may hold ten times the other's points: opponents must lie on the sheet
    # in their mean, however wide the net is cast.
    drift = _DRIFT * spacing
    for number in range(_ROUNDS):
        scale = spacing * 2.0**number
        reach, tolerance = _EDGE * scale, _TOLERANCE * scale
        keys, _, cell_of = kernels.count_cells(positions, low, reach)
        verdicts = kernels.poll_normals(
            positions, mended, keys, cell_of, asked, reach, tolerance, drift, threads
        )
        wrong = verdicts == WRONG
        if wrong.any():
            # The next round votes with what is mended; what is wrong once more was right at first.
            is_flipped ^= wrong
            mended = np.where(is_flipped[:, None], -normals, normals)
        # (n,): 1 where neither side has the majority; the next round asks neighbours farther away.
        asked = (verdicts == UNSURE).astype(np.uint8)
        if not asked.any():
            break
    return is_flipped


def share_opposed(
    positions: FloatArray, normals: FloatArray, low: FloatArray, edge: float, spacing: float
) -> float:
    """Return the share of opposite pairs of normals among those on one sheet, in boxes.

    It is 0.5 where signs are random, 2 f (1 - f) where a share f is flipped. Positions and unit
    normals (n, 3) are of boxes of an edge (`kernels.sample_boxes`); `low`, (3,), has the cloud's
    least coordinates.
    """
    cosines = _pair_up(positions, normals, low, edge, spacing)[2]
    return float(np.count_nonzero(cosines < 0.0) / max(len(cosines), 1))


@dataclass(frozen=True, slots=True)
class Torn:
    """How far normals follow a place, or a direction, and not a surface.

    A share of them, `following`, is on the side of one place. Of the `pairs` on one sheet that are
    across the line of sight from there, a share, `torn`, is opposite.
    """

    following: float
    pairs: int = 0
    torn: float = 0.0

    @property
    def is_torn(self) -> bool:
        """Whether the sides are those of a place."""
        return self.following >= FOLLOWING and self.pairs >= _FEWEST_TORN and self.torn > TORN


def weigh_torn(
    positions: FloatArray, normals: FloatArray, low: FloatArray, edge: float, spacing: float
) -> Torn:
    """Weigh whether the sides of normals follow a place, and not a surface; see `share_opposed`.

    Notes
    -----
    A place q is sought, in homogeneous coordinates, so that all normals are on its side, or on
    the other one. Where there is one, they may be those of a view, or of a ball. But where they
    are across the line of sight, those of a surface still agree with their neighbours, and those
    that were turned to a place oppose each other.
    """
    if len(positions) < _FEWEST_JUDGED:
        return Torn(0.0)
    # (n, 4): a place at unit distance is (q, 1), a direction (q, 0)
    corners = bound_points(positions)
    size = max(float((corners[1] - corners[0]).max()), 1e-300)
    local = (positions - positions.mean(axis=0)) / size
    planes = np.column_stack([normals, -np.einsum("ij,ij->i", normals, local)])
    # (4,): so few numbers that a sample of the planes determines them.
    place = _find_place(planes[:: -(-len(planes) // _SEEKING)])
    following = float(np.mean(planes @ place > 0.0))
    if following < FOLLOWING:
        return Torn(following)
    # (n, 3): unit vectors to the place; where that is a direction, the same one for all points.
    sights = place[:3] - place[3] * local
    sights /= np.maximum(np.sqrt(np.einsum("ij,ij->i", sights, sights)), 1e-300)[:, None]
    is_across = np.abs(np.einsum("ij,ij->i", sights, normals)) < _ACROSS
    one, other, cosines = _pair_up(positions, normals, low, edge, spacing)
    # Only these pairs tell: elsewhere normals of a surface that are turned to a place agree, too.
    across = cosines[is_across[one] & is_across[other]]
    return Torn(following, len(across), float(np.count_nonzero(across < 0.0) / max(len(across), 1)))


def _find_place(planes: FloatArray) -> FloatArray:
    """Return the vector with most of the planes on its side: a perceptron's, from their mean.

    The best axis, where it finds no better.
    """
    # (8, 4): what is returned at worst, as the search does not always come to an end.
    axes = np.concatenate([np.eye(4), -np.eye(4)])
    shares = (planes @ axes.T > 0.0).mean(axis=0)
    best: FloatArray = axes[int(np.argmax(shares))]
    share, place = float(shares.max()), planes.mean(axis=0)
    for step in range(_STEPS):
        is_wrong = planes @ place <= 0.0
        right = 1.0 - np.count_nonzero(is_wrong) / len(planes)
        if right > share:
            best, share = place, right
        if share == 1.0 or (step == _HOPELESS and share < 0.85):
            break
        place = place / max(float(np.sqrt(place @ place)), 1e-300)
        # Towards the planes on the wrong side, by shorter and shorter steps, so that it settles.
        place = place + planes[is_wrong].mean(axis=0) * (0.5 / (1.0 + 0.05 * step))
    return best


def _pair_up(
    positions: FloatArray, normals: FloatArray, low: FloatArray, edge: float, spacing: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the rows of pairs of points on one sheet, in boxes, and the cosines of normals."""
    places = np.floor(cells_of(positions, low, edge)).astype(np.int64)
    _, boxes = number_keys(pack_places(places))
    # Box by box: the partners of a point are the next few rows, as far as they are of its box.
    order = np.argsort(boxes, kind="stable")
    positions, normals, boxes = positions[order], normals[order], boxes[order]
    found = []
    for step in range(1, min(_PAIRS + 1, len(boxes))):
        one, other = normals[:-step], normals[step:]
        arms = positions[step:] - positions[:-step]
        # (n - step,) each: how far each point of a pair is off the plane of the other.
        offsets = [np.abs(np.einsum("ij,ij->i", arms, some)) for some in (one, other)]
        cosines = np.einsum("ij,ij->i", one, other)
        # Normals that are about at right angles tell nothing of their sides.
        is_pair = (boxes[step:] == boxes[:-step]) & (np.abs(cosines) > 0.5)
        rows = np.flatnonzero(is_pair & (np.maximum(*offsets) <= _TOLERANCE * spacing))
        found.append((order[rows], order[rows + step], cosines[rows]))
    if not found:
        return order[:0], order[:0], np.empty(0)
    firsts, seconds, all_cosines = zip(*found, strict=True)
    return np.concatenate(firsts), np.concatenate(seconds), np.concatenate(all_cosines)
