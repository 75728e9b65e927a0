"""The side of every patch, over the whole object at once.

::

    views from free space ──────────┐
    far field of the signed normals ┴─> leanings of patches ── spread over links ──> sides
                    └────────────────────── until none changes ────────────────────────┘
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import cg

from hpcapp.applications.surface.kernels import integrate_normals, sample_grid
from hpcapp.applications.surface.normals.patches import CELL, Links, Patches, Sides
from hpcapp.applications.surface.normals.visibility import (
    find_seen,
    poll_views,
    stand_inside,
    surround,
)
from hpcapp.applications.surface.types.points import BoolArray, FloatArray, IntArray

__all__ = ["SURE", "orient_patches"]

SURE = 0.3
"""From this confidence on the side of a patch counts as sure."""

_VIEWS = 64
_HIDDEN = 0.02  # share of the area that no view from outside shows, and then
_ROOMY = 0.5  # share of the area that one viewpoint inside shows,
_BELIEVED = 0.5  # share of the area that may be hidden from scanners
_ALIKE = 0.3  # of the better seen side, that the other one shows
_OPEN = 0.3  # share of the area that is seen from both sides: a sheet
_NEAR = 10.0  # longest sides from the middle to a camera at zero
_OCCLUDED = 0.5  # share of the area that may be hidden from it
_FLAT = 0.5  # of the longest side, below which a sheet is a ground
_SHOWN = 0.25  # share of what is hidden outside that is hidden inside, too: it is a room
_GLIMPSE = 0.005  # mean of cosines over all views: what is seen less is hidden
_POWER = 4  # of the agreement of two patches, in the strength of their link
_MOST_CONTACTS = 4.0  # by the square root of the points: more make a link no stronger
_STACKED = 4.0  # standard deviations between two sheets that are told apart
_FREE = 1e-6  # how strongly patches that nobody sees are drawn to no side
_LEAN = 0.3  # how strongly all that is known of a patch counts beside its links
_UP = 0.1  # how much a normal that points up leans to that side
_CLEAR = 0.5  # share of the views that makes a patch's leaning a whole one
_NODES = 128
_PADDING = 1.3
_ROUNDS = 12
_SETTLED = 1e-3  # share of patches that still change sides
_TOLERANCE = 1e-3
_STEPS = 300


def orient_patches(
    patches: Patches,
    links: Links,
    spacing: float,
    zero: FloatArray,
    scanners: FloatArray | None = None,
    *,
    is_flown: bool = False,
) -> Sides:
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
    scanners : ndarray of float64, shape (s, 3), optional
        Where scanners stood, in the frame of the patches. They are not believed where they would
        not have seen half of the object.
    is_flown : bool
        Whether the file says that the points were measured from above. Then a ray came down to
        each, whatever others hide it from view, and what they hide is no evidence. It is believed
        of what is flat: some scanners on tripods write the same.

    Notes
    -----
    Without scanners the object is seen from all around. A sheet that is seen from both sides alike
    is seen from `zero` if that shows nearly all of it (a camera's frame), else from above if it is
    flat (a ground). And what shows less from outside than from inside is a room.

    A side is a number x between -1 and 1 for each patch that minimizes

        sum over links  |w| (x_a - sign(w) x_b)^2  +  sum over patches  c (x - u)^2

    The strength w of a link is the agreement of the two normals, one of them mirrored along the
    line between the centres, so that it holds around edges and on both sides of a plate. The
    leaning u is what views say (the side that is seen from more directions) and, from the second
    round on, what the far field says: the gradient of the solution of a Poisson equation with the
    normals, as they are now, on its right-hand side. The linear system is solved by conjugate
    gradients; |x| is the confidence.

    References
    ----------
    Koenig and Gumhold (2009), Consistent propagation of normal orientations in point clouds.
    """
    strengths = _rate_links(patches, links)
    system = _System(len(patches), links, strengths)
    is_flown = is_flown and _is_flat(patches)
    if is_flown:
        up = patches.normals[:, 2]
        front, back, views = np.maximum(up, 0.0), np.maximum(-up, 0.0), 1
    else:
        front, back, views = _look(patches, spacing, zero, scanners)
    whole = _CLEAR * views / 4.0  # a half space of directions sums up to a quarter of all
    leaning = (front - back) / whole
    if scanners is None:  # a sheet that is seen from both sides alike is a ground: it faces up
        leaning += _UP * patches.normals[:, 2]
    leaning = np.clip(leaning, -1.0, 1.0)
    weight = np.minimum((front + back) / whole, 1.0)
    sides = system.solve(_LEAN * weight, leaning, np.zeros(len(patches)))
    for _ in range(_ROUNDS):
        signs = np.where(sides < 0.0, -1.0, 1.0)
        field = _ask_field(patches, np.clip(2.0 * sides, -1.0, 1.0), spacing)
        # What a ray has told, the far field does not contradict: it tells of walls alone.
        asked = 1.0 - weight if is_flown else np.ones(len(patches))
        total = weight + asked
        sides = system.solve(_LEAN * total, (weight * leaning + asked * field) / total, sides)
        changed = np.count_nonzero(signs != np.where(sides < 0.0, -1.0, 1.0))
        if changed <= _SETTLED * len(patches):
            break
    values = np.clip(sides, -1.0, 1.0).astype(np.float32)
    return Sides(patches.keys, patches.ranks, values)


def _look(
    patches: Patches, spacing: float, zero: FloatArray, scanners: FloatArray | None
) -> tuple[FloatArray, FloatArray, int]:
    """Poll the viewpoints that see the object best; see `poll_views`. Return their number, too."""
    if scanners is not None:
        seen = poll_views(patches, scanners, spacing)
        if _share_hidden(patches, *seen, len(scanners)) < _BELIEVED:
            return *seen, len(scanners)
    outside = surround(patches, _VIEWS)
    found = poll_views(patches, outside, spacing)
    hidden = _share_hidden(patches, *found, len(outside))
    is_open = np.minimum(*found) > _ALIKE * np.maximum(*found)
    if _share_of(patches, is_open) > _OPEN:
        others = _face_sheet(patches, outside, zero)
    elif hidden > _HIDDEN and _see_most(patches, spacing, stand_inside(patches)):
        others = [(stand_inside(patches), _SHOWN * hidden)]
    else:
        others = []
    # What was scanned was seen: by a camera, from the air, or by somebody in the middle of it.
    for viewpoints, most_hidden in others:
        seen = poll_views(patches, viewpoints, spacing)
        if _share_hidden(patches, *seen, len(viewpoints)) < most_hidden:
            return *seen, len(viewpoints)
    return *found, len(outside)


def _face_sheet(
    patches: Patches, outside: FloatArray, zero: FloatArray
) -> list[tuple[FloatArray, float]]:
    """Return who may have seen an open sheet, and what share may have been hidden from them."""
    low, high = patches.centres.min(axis=0), patches.centres.max(axis=0)
    size = high - low
    others = []
    if np.abs(zero - 0.5 * (low + high)).max() < _NEAR * size.max():
        others.append((zero[None], _OCCLUDED))
    if _is_flat(patches):
        others.append((outside[outside[:, 2] > high[2]], 1.0))
    return others


def _is_flat(patches: Patches) -> bool:
    size = np.ptp(patches.centres, axis=0)
    return bool(size[2] < _FLAT * size.max())


def _see_most(patches: Patches, spacing: float, viewpoints: FloatArray) -> bool:
    """Tell whether one viewpoint alone shows most of the area."""
    seen = (find_seen(patches, viewpoint, spacing)[1] for viewpoint in viewpoints)
    return max(_share_of(patches, one) for one in seen) > _ROOMY


def _share_hidden(patches: Patches, front: FloatArray, back: FloatArray, views: int) -> float:
    return _share_of(patches, front + back < _GLIMPSE * views)


def _share_of(patches: Patches, chosen: BoolArray) -> float:
    """Return the share of the area that some patches have."""
    areas = np.minimum(patches.counts / CELL**2, 1.0)
    return float(areas[chosen].sum() / areas.sum())


def _rate_links(patches: Patches, links: Links) -> FloatArray:
    """Return how strongly two patches are linked: below 0 where their normals disagree."""
    first, second = links.first, links.second
    one, other = patches.normals[first], patches.normals[second]
    arms = patches.centres[second] - patches.centres[first]
    lengths = np.maximum(np.sqrt(_dot(arms, arms)), 1e-300)
    arms = arms / lengths[:, None]
    along_one, along_other = _dot(arms, one), _dot(arms, other)
    cosines = _dot(one, other)
    agreement: FloatArray = cosines - 2.0 * along_one * along_other
    fewer = np.minimum(patches.counts[first], patches.counts[second])
    strengths: FloatArray = np.sign(agreement) * np.abs(agreement) ** _POWER
    strengths *= np.minimum(links.contacts / np.sqrt(fewer), _MOST_CONTACTS)
    # Two layers of one noisy sheet look like the two sides of a plate.
    apart = np.minimum(np.abs(along_one), np.abs(along_other)) * lengths
    noise = np.sqrt(patches.noise[first] * patches.noise[second])
    is_stacked = (agreement * cosines < 0.0) & (np.abs(cosines) > 0.5)
    strengths[is_stacked & (apart < _STACKED * noise)] = 0.0
    return strengths


class _System:
    """The equations that spread leanings over links."""

    def __init__(self, count: int, links: Links, strengths: FloatArray) -> None:
        first, second = links.first, links.second
        rows, columns = np.concatenate([first, second]), np.concatenate([second, first])
        both = np.concatenate([strengths, strengths])
        self._links = csr_matrix((both, (rows, columns)), shape=(count, count))
        self._sums = np.bincount(rows, np.abs(both), count) + _FREE

    def solve(self, weights: FloatArray, leanings: FloatArray, start: FloatArray) -> FloatArray:
        diagonal = self._sums + weights
        matrix = diags(diagonal) - self._links
        sides: FloatArray
        sides, _ = cg(
            matrix,
            weights * leanings,
            x0=start,
            rtol=_TOLERANCE,
            maxiter=_STEPS,
            M=diags(1.0 / diagonal),
        )
        return sides


def _ask_field(patches: Patches, sides: FloatArray, spacing: float) -> FloatArray:
    """Return how far the far field of the patches agrees with the normal of each: -1 to 1."""
    low, high = patches.centres.min(axis=0), patches.centres.max(axis=0)
    extent = max(float((high - low).max()), CELL * spacing)  # of one patch, its own
    step = _PADDING * extent / _NODES
    origin = 0.5 * (low + high) - 0.5 * step * _NODES
    places = (patches.centres - origin) / step
    areas = np.minimum(patches.counts / CELL**2, 1.0) * (CELL * spacing / step) ** 2
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


def _dot(first: FloatArray, second: FloatArray) -> FloatArray:
    dots: FloatArray = np.einsum("ij,ij->i", first, second)
    return dots
