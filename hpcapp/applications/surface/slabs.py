"""The surface of a cloud in memory, made right here: its finest level in slabs, one at a time.

::

    points ─> coarser levels, far field ─> slab: finest quadrics ─> bricks ─> MeshPart
                                             ^        the next one, and again where    │
                                             └── the surface goes on in another slab <─┘

The finest level has most of all quadrics, a hundred bytes for each point. Keys sort by x first: a
slab of the grid across x asks for one run of them, and of the cells and points that they come of.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from hpcapp.applications.surface.coarse import solve_far
from hpcapp.applications.surface.method import Advance
from hpcapp.applications.surface.surface import PartSurface
from hpccomponent.surface import kernels
from hpccomponent.surface.field import BRICK, Field, FieldLevel
from hpccomponent.surface.field_levels import find_trust, fit_finest
from hpccomponent.surface.lattice import find_keys, find_layers, unique_keys, unpack_keys
from hpccomponent.surface.mesh_part import cut_part
from hpccomponent.surface.part_summary import summarize_part
from hpccomponent.surface.points import IntArray, PointCloud
from hpccomponent.surface.pyramid import Pyramid, build_pyramid, fit_levels
from hpccomponent.surface.reach import plan_slab
from hpccomponent.surface.region import Plan, sample_cells

__all__ = ["SLAB_QUADRICS", "mesh_slabs"]

SLAB_QUADRICS = 3_000_000
"""Of the finest level, in a slab: 0.2 GB."""

_LEAST_LAYERS = 8  # of bricks in a slab: those beside it are evaluated too, one on each side


def mesh_slabs(
    cloud: PointCloud, plan: Plan, threads: int, advance: Advance
) -> tuple[PartSurface, int]:
    """Reconstruct the surface of a cloud.

    Parameters
    ----------
    cloud : PointCloud
        With normals.
    plan : Plan
    threads : int
        The result does not depend on it.
    advance : callable
        Told (slabs done, slabs in all).

    Returns
    -------
    surface : PartSurface
        It holds every brick that the surface reaches, each in one part.
    patches : int
        Finest cells with points.
    """
    work = _Slabs(cloud, plan, threads)
    bounds = work.cut(SLAB_QUADRICS)
    for done, (first, end) in enumerate(pairwise(bounds), start=1):
        work.mesh(first, end, work.seeds)
        advance(done, len(bounds) - 1)
    while len(left := work.left()):
        for first, end in pairwise(bounds):
            work.mesh(first, end, left)
    return work.surface, work.patches


class _Slabs:
    """The levels of a cloud, and the surface as far as it has been made."""

    def __init__(self, cloud: PointCloud, plan: Plan, threads: int) -> None:
        pyramid = build_pyramid(cloud, plan.origin, plan.cell_size, plan.height, threads)
        self.seeds = kernels.seed_bricks(plan.grid, cloud.positions)
        self.patches = len(pyramid.levels[0].cells)
        self.surface = PartSurface([], [], cloud.origin)
        self._plan, self._threads = plan, threads
        self._far = solve_far(plan, *sample_cells(pyramid.levels[plan.far]), threads)
        quadrics, self._parents = fit_levels(pyramid, plan.weights, None, threads, lowest=1)
        levels, vertices = pyramid.levels, pyramid.vertices
        above = Pyramid(plan.origin, plan.cell_size, levels[1:], vertices[1:], 1, plan.height)
        self._above = find_trust(above, quadrics, self._far, threads)
        self._finest, self._vertices = levels[0], vertices[0]
        self._exits = [np.empty(0, np.int64)]

    def cut(self, quadrics: int) -> list[int]:
        """Cut the grid into slabs with about so many of the finest quadrics; return their bounds.

        Each bound is a layer of bricks, counted along x.
        """
        layers = self._plan.grid.bricks[0]
        count = min(-(-len(self._vertices) // quadrics), max(1, layers // _LEAST_LAYERS))
        rows = np.arange(1, count) * len(self._vertices) // count
        corners = self._plan.cell_size * unpack_keys(self._vertices[rows])[:, 0]
        shift = self._plan.origin[0] - self._plan.grid.origin[0]
        cuts = np.floor((corners + shift) / (BRICK * self._plan.step)).astype(np.int64)
        bounds: list[int] = np.unique(np.clip([0, *cuts, layers], 0, layers)).tolist()
        return bounds

    def mesh(self, first: int, end: int, begin: IntArray) -> None:
        """Add the surface in a slab, as far as some bricks in it lead; all others are foreign."""
        layer = unpack_keys(begin)[:, 0]
        own = begin[(layer >= first) & (layer < end)]
        if not len(own):
            return
        plan, grid = self._plan, self._plan.grid
        held = [found.bricks for found in self.surface.summaries]
        kinds = plan_slab(grid, first, end, own, np.concatenate([self.seeds, *held]))
        field = Field(plan.origin, plan.cell_size, (self._fit(first, end), *self._above), self._far)
        mesh = kernels.grow_surface(field, grid, kinds, self._threads)
        del field
        balanced = kernels.balance_vertices(mesh.vertices, mesh.faces, plan.step)
        mesh = replace(mesh, vertices=balanced)
        self._exits.append(mesh.exits)
        part = cut_part(mesh, kinds)
        del mesh, balanced  # makes room for what the summary takes
        self.surface.parts.append(part)
        self.surface.summaries.append(summarize_part(part))

    def left(self) -> IntArray:
        """Return the bricks that the surface leaves for, and that no part has."""
        wanted = unique_keys(np.concatenate(self._exits))
        held = unique_keys(np.concatenate([found.bricks for found in self.surface.summaries]))
        left: IntArray = wanted[find_keys(held, wanted) == len(held)]
        return left

    def _fit(self, first: int, end: int) -> FieldLevel:
        """Fit the finest quadrics that a slab asks for, and those beside it."""
        plan = self._plan
        nodes = BRICK * np.array([first - 1, end + 1]) * plan.step
        places = (plan.grid_origin[0] + nodes - plan.origin[0]) / plan.cell_size
        low, high = int(np.floor(places[0])), int(np.floor(places[1])) + 1
        vertices = self._vertices[find_layers(self._vertices, low, high)]
        pyramid = Pyramid(plan.origin, plan.cell_size, [self._finest], [vertices], 0, plan.height)
        return fit_finest(pyramid, plan.weights, self._parents, self._far, self._threads)
