"""The implicit function at the nodes of bricks: levels of quadrics, far field behind them.

A brick has 8^3 cells of the evaluation grid and 9^3 nodes; it shares the outer ones with its
neighbours. The value of a node is a function of the node's index alone, in a fixed order of
operations, and is rounded to float32: bricks agree on what they share, and workers on everything.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.fitting.blending import (
    NODES,
    blend_quadrics,
    cross_axes,
    interpolate_far,
    needed_layers,
)
from hpccomponent.surface.fitting.far_field import FarField
from hpccomponent.surface.types.lattice import find_keys, pack_places
from hpccomponent.surface.types.points import FloatArray, IntArray

__all__ = [
    "BRICK",
    "CHANNELS",
    "Field",
    "FieldLevel",
    "Grid",
    "evaluate_bricks",
]

BRICK = NODES - 1
"""Cells along the edge of a brick."""

CHANNELS = 12
"""Ten coefficients, presence and trust of a vertex."""

_CHUNK_NODES = 1 << 17
_LEAST_REST = 1e-6  # what is left to the levels behind is 0 below this, and they are not asked
_TINY = np.float32(1e-30)

Float32Array = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """The evaluation grid.

    Parameters
    ----------
    origin : ndarray of float64, shape (3,)
        Where node (0, 0, 0) lies.
    step : float
        Edge of a cell, in length units of the input.
    bricks : tuple of int
        Bricks along x, y and z.
    """

    origin: FloatArray
    step: float
    bricks: tuple[int, int, int]

    @property
    def box(self) -> tuple[FloatArray, FloatArray]:
        """The first node and the last, in length units of the input."""
        return self.origin, self.origin + self.step * BRICK * np.array(self.bricks)


@dataclass(frozen=True, slots=True, eq=False)
class FieldLevel:
    """The quadrics of one lattice.

    Parameters
    ----------
    keys : ndarray of int64, shape (v,)
        Sorted keys of the lattice's vertices.
    coefficients : ndarray of float32, shape (v, 10)
        The quadric of each vertex, in cells of this lattice.
    trust : ndarray of float32, shape (v,)
        What it counts against the levels behind and the far field, 0 to 1.
    """

    keys: IntArray
    coefficients: Float32Array
    trust: Float32Array

    def channels(self) -> FloatArray:
        """Return coefficients, 1 and trust, shape (12, v + 1).

        The last column, all zero, stands for a vertex that is missing.
        """
        channels = np.zeros((CHANNELS, len(self.keys) + 1))
        channels[:10, :-1] = self.coefficients.T
        channels[10, :-1] = 1.0
        channels[11, :-1] = self.trust
        return channels


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """All that the implicit function is made of.

    Parameters
    ----------
    origin : ndarray of float64, shape (3,)
        Where corner (0, 0, 0) of every lattice lies.
    cell_size : float
        Edge of a cell of the finest lattice, in length units of the input.
    levels : tuple of FieldLevel
        Finest first; the cells of each are twice as large as those of the one before.
    far : FarField
    """

    origin: FloatArray
    cell_size: float
    levels: tuple[FieldLevel, ...]
    far: FarField


def evaluate_bricks(field: Field, grid: Grid, places: IntArray) -> Float32Array:
    """Evaluate the implicit function at all nodes of some bricks.

    Parameters
    ----------
    field : Field
    grid : Grid
    places : ndarray of int64, shape (b, 3)
        Which bricks.

    Returns
    -------
    ndarray of float32, shape (b, 9, 9, 9)
        In cells of the finest lattice, positive outside, never 0; the outermost nodes of
        the grid are positive, so that every surface closes inside it.

    Notes
    -----
    Front to back, as transparent layers are composed: F = sum of rest_d t_d f_d + rest far, with
    f_d the quadrics of level d blended, t_d their trust, and rest_d the product of 1 - t over the
    levels in front. So coarse levels fill in where the points are too far apart for fine ones.
    """
    values = np.empty((len(places), NODES, NODES, NODES), np.float32)
    reach = BRICK * grid.step / field.cell_size
    layers = min(2 * NODES, int(reach) + 3)
    chunk = max(1, _CHUNK_NODES // max(NODES * layers**2, NODES**3))
    channels = [level.channels() for level in field.levels]
    for start in range(0, len(places), chunk):
        rows = slice(start, start + chunk)
        values[rows] = _evaluate_chunk(field, channels, grid, places[rows])
    return values


def _evaluate_chunk(
    field: Field, channels: list[FloatArray], grid: Grid, places: IntArray
) -> Float32Array:
    """Evaluate a few bricks."""
    nodes = BRICK * places.T[:, :, None] + np.arange(NODES)
    total, rest = np.zeros((len(places), *[NODES] * 3)), np.ones((len(places), *[NODES] * 3))
    for depth, level in enumerate(field.levels):
        scale = 2.0**depth
        lower, local = _locate(nodes, grid, field.origin, field.cell_size * scale)
        layers, lower = needed_layers(lower)
        corners = np.stack(np.broadcast_arrays(*cross_axes(layers)), axis=-1)
        rows = find_keys(level.keys, pack_places(corners))
        quadric, presence, trust = blend_quadrics(channels[depth], rows, lower, local)
        near = scale * quadric / np.where(presence > 0.0, presence, 1.0)
        total += rest * trust * near
        rest *= 1.0 - trust
        rest[rest < _LEAST_REST] = 0.0
    far_lower, far_local = _locate(nodes, grid, field.far.origin, field.far.step)
    total += rest * (interpolate_far(field.far.values, far_lower, far_local) / field.cell_size)
    return _settle_signs(total.astype(np.float32), nodes, grid)


def _settle_signs(values: Float32Array, nodes: IntArray, grid: Grid) -> Float32Array:
    """Move zeros off the surface, and the outermost nodes outside."""
    values[values == 0.0] = _TINY
    last = BRICK * np.array(grid.bricks)[:, None, None]
    x, y, z = cross_axes((nodes == 0) | (nodes == last))
    return np.where(x | y | z, np.abs(values), values)


def _locate(
    nodes: IntArray, grid: Grid, origin: FloatArray, size: float
) -> tuple[IntArray, FloatArray]:
    """Return the cell of a lattice that each node coordinate lies in, and where in it (0 to 1).

    All of shape (3, b, 9). The result depends on the node's index only, never on its brick.
    """
    offset = (grid.origin - origin)[:, None, None]
    coordinates = (nodes * grid.step + offset) / size
    lower = np.floor(coordinates)
    return lower.astype(np.int64), coordinates - lower
