"""From the spacing of the points to the grid: where the resolution of a mesh is chosen.

::

    spacing, noise ── estimates ──> cells: finest, coarsest ── refinement ──> lattice
                                                                                 │
    grid as asked for, or as suggested ──> steps of the finest bricks ── strides ┴──> grid
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.cloud.point_workers import PointWorkers
from hpcapp.applications.surface.field.refinement import Refinement
from hpcapp.applications.surface.field.weights import believe_noise
from hpcapp.applications.surface.methods.method import MARGIN
from hpcapp.applications.surface.resolution.estimates import Scale, choose_scale
from hpcapp.applications.surface.resolution.strides import choose_strides
from hpcapp.geometry.lattice import lay_lattice
from hpcapp.geometry.points import FloatArray
from hpcapp.kernels.types.grid import BRICK, MOST_SHIFT, Grid
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

_EXACT = 1e-3  # steps: equal sides have equally many


@dataclass(frozen=True, slots=True, eq=False)
class Resolved:
    """How fine a cloud is fitted, and how fine its surface is sampled.

    The scale has the sizes of the cells and the estimates that led to them, the refinement tells
    where the lattice has which; the grid has strides where bricks ask for unlike steps.
    """

    scale: Scale
    refinement: Refinement
    grid: Grid


def resolve(
    cloud: ArrangedCloud,
    cells: int,
    smoothness: float,
    detail: float,
    *,
    uniform: bool,
    workers: PointWorkers,
    threads: int,
) -> Resolved:
    """Follow the chain for a cloud with normals, and a grid of so many `cells` (see `plan_grid`).

    A `uniform` grid has one step, however uneven the points lie; else `workers` count points where
    strides differ. InputError where there are no normals, or all points are the same.
    """
    low, high, measured = cloud.low, cloud.high, cloud.measured
    grid = plan_grid(low, high, cells)
    scale = choose_scale(measured, grid.step, smoothness, detail, threads)
    origin = lay_lattice(low, scale.finest)
    noise = scale.noise.scaled(smoothness * believe_noise(scale.noise.whole / scale.spacing))
    refinement = Refinement(
        scale.levels, scale.spacings, measured.scale, origin, scale.finest, noise
    )
    if scale.levels and not uniform:
        wide = plan_grid(low, high, cells, MARGIN << MOST_SHIFT)
        seeds, _ = workers.count_cells(cloud, wide.origin, BRICK * wide.step)
        if (strides := choose_strides(wide, seeds, refinement)) is not None:
            grid = replace(wide, strides=strides)
    return Resolved(scale, refinement, grid)


def plan_grid(low: FloatArray, high: FloatArray, cells: int, margin: int = MARGIN) -> Grid:
    """Lay the evaluation grid around a cloud, whose box has the corners `low` and `high`, (3,).

    It has so many `cells` along the longest side, with about four to spare at each end; in fact it
    is the `margin` that is to spare: where strides differ, a cell may be as large as a brick. It is
    centred on the cloud but for a part of a step: flat sides lie on no nodes. Each side is a whole
    number of bricks. InputError where all points are the same.
    """
    longest = float((high - low).max())
    if longest <= 0.0:
        raise InputError("all points lie at one place", "scan something with an extent")
    step = longest / (cells - 2 * MARGIN)
    sides = np.ceil((high - low) / step + 2 * margin - _EXACT)
    x, y, z = (int(bricks) for bricks in np.ceil(sides / BRICK))
    half = 0.5 * BRICK * step * np.array([x, y, z])
    return Grid(lay_lattice(0.5 * (low + high) - half, step), step, (x, y, z))
