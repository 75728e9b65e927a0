"""Regions of an arranged cloud: whole blocks, and what of their surroundings a task must know."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.tiles import morton_codes
from hpccomponent.surface.arranged_cloud import ArrangedCloud, cut_blocks
from hpccomponent.surface.lattice import find_keys, pack_places, unpack_keys
from hpccomponent.surface.points import FloatArray, IntArray

__all__ = ["Region", "cut_regions", "take_region"]


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """The points in some blocks and around them, in the order of the cloud.

    Parameters
    ----------
    positions, normals : ndarray of float64, shape (n, 3)
    own : ndarray of bool, shape (n,)
        Which of them lie in these blocks.
    """

    positions: FloatArray
    normals: FloatArray
    own: NDArray[np.bool_]


def cut_regions(keys: IntArray, counts: IntArray, points: int) -> list[IntArray]:
    """Cut a cloud into regions of about so many points, as compact as blocks allow.

    Parameters
    ----------
    keys, counts : ndarray of int64, shape (b,)
        Of the cloud's blocks.
    points : int
        In a region, at most, unless one block has more.

    Returns
    -------
    list of ndarray of int64
        Sorted keys of each region's blocks: a run along the Morton curve.
    """
    order = np.argsort(morton_codes(keys))
    return [np.sort(keys[order[run]]) for run in cut_blocks(counts[order], points)]


def take_region(cloud: ArrangedCloud, blocks: IntArray, margin: float) -> Region:
    """Take the points in some blocks of a cloud, and those around them.

    Parameters
    ----------
    cloud : ArrangedCloud
    blocks : ndarray of int64, shape (k,)
        Sorted keys.
    margin : float
        How far around, in length units of the input.

    Returns
    -------
    Region
        No point of the cloud within the margin is missing.
    """
    arrangement = cloud.arrangement
    steps = int(np.ceil(margin / arrangement.edge))
    positions, normals = cloud.take_blocks(_find_near(cloud.keys, blocks, steps))
    places = np.floor((positions - arrangement.origin) / arrangement.edge).astype(np.int64)
    own = find_keys(blocks, pack_places(places)) < len(blocks)
    corners = unpack_keys(blocks)
    low = arrangement.origin + corners.min(axis=0) * arrangement.edge - margin
    high = arrangement.origin + (corners.max(axis=0) + 1) * arrangement.edge + margin
    near = ((positions >= low) & (positions <= high)).all(axis=1)
    if near.all():
        return Region(positions, normals, own)
    return Region(positions[near], normals[near], own[near])


def _find_near(keys: IntArray, blocks: IntArray, steps: int) -> IntArray:
    """Return those of a cloud's blocks that lie so many steps from some of them, or fewer."""
    places, wanted = unpack_keys(keys), unpack_keys(blocks)
    low = places.min(axis=0)
    sides = places.max(axis=0) - low + 1  # some 64 at most: see `choose_arrangement`
    near = np.zeros(sides, np.int64)
    near[tuple((wanted - low).T)] = 1
    for axis, side in enumerate(sides):
        summed = np.insert(np.cumsum(near, axis=axis), 0, 0, axis=axis)
        at = np.arange(side)
        above = summed.take(np.minimum(at + steps + 1, side), axis=axis)
        near = np.sign(above - summed.take(np.maximum(at - steps, 0), axis=axis))
    is_near: NDArray[np.bool_] = near[tuple((places - low).T)] > 0
    return keys[is_near]
