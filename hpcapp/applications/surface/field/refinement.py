"""Where the lattice under a cloud is finer than at its base: where points are dense enough for it.

::

    level 0          divided cells of level 1 only     their corners, and ancestors of these
      ...
    level `levels`   the base: all cells with points

A cell that is not divided is a leaf. Its points speak through the quadrics at its corners, and no
finer ones: these are the finest there, whatever level they are on.
"""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.field.local_noise import LocalNoise
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.geometry.lattice import ancestor_keys, unique_keys, unpack_keys
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record


@record("surface.refinement")
@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """Which cells of a lattice are divided, by the scale and the noise of its points.

    There are so many `levels` below the base, whose finest cells are of `cell_size`; corner (0, 0,
    0) of each lies at `origin` (3,). A cell that points are dense enough for is `spacings` wide at
    least.
    """

    levels: int
    spacings: float
    scale: LocalScale
    origin: FloatArray
    cell_size: float
    noise: LocalNoise

    @classmethod
    def none(cls) -> Refinement:
        """Return that of a lattice that is nowhere finer than at its base."""
        return cls(0, 1.0, LocalScale.uniform(1.0), np.zeros(3), 1.0, LocalNoise.none())

    def divides(self, cells: IntArray, depth: int) -> BoolArray:
        """Tell which cells (c,) with points of level `depth`, 0 the finest, are divided, (c,)."""
        if not 0 < depth <= self.levels:
            return np.zeros(len(cells), np.bool_)
        wanted = self.wanted_sizes(self._middles(cells, depth))
        divided: BoolArray = wanted <= 0.5 * self.cell_size * 2.0**depth
        return divided

    def wanted_sizes(self, places: FloatArray) -> FloatArray:
        """Return how large cells are to be at some places, at least."""
        return self.spacings * self.scale.at(places)

    def noise_around(self, corners: IntArray, depth: int) -> FloatArray:
        """Return, in a level's cells squared, the variances (v,) of noise around corners (v,)."""
        size = self.cell_size * 2.0**depth
        places = self.origin + size * unpack_keys(corners)
        return self.noise.variances_at(places) / (size * size)

    def thin(self, cells: IntArray, depth: int) -> FloatArray:
        """Return what share (c,) of the points in cells (c,) would be there by the whole's.

        It is 1 at most, where points are as dense as those of the whole cloud or less.
        """
        spacings = self.scale.at(self._middles(cells, depth))
        share: FloatArray = np.minimum(1.0, (spacings / self.scale.spacing) ** 2)
        return share

    def _middles(self, cells: IntArray, depth: int) -> FloatArray:
        middles: FloatArray = self.origin + self.cell_size * 2.0**depth * (unpack_keys(cells) + 0.5)
        return middles

    def mark_finest(self, corners: IntArray, cells: IntArray, depth: int) -> BoolArray:
        """Tell at which corners of a level no finer quadrics are: those of its leaves.

        `corners` (v,) and `cells` (c,), those with points all around the corners, are sorted keys
        of level `depth`, 0 the finest.
        """
        if depth > self.levels:
            return np.zeros(len(corners), np.bool_)
        if not depth:
            return np.ones(len(corners), np.bool_)
        of_leaves = kernels.spread_keys(cells[~self.divides(cells, depth)], 0, 1)
        finest: BoolArray = kernels.find_keys(of_leaves, corners) < len(of_leaves)
        return finest

    def lay(self, cells: list[IntArray], base: IntArray) -> list[IntArray]:
        """Return the corners that carry quadrics from the finest level to the base, level by level.

        They are those of the children of divided cells and of their neighbours, and ancestors.
        `cells` are sorted keys of cells with points, of each level below the base; `base` (v,) are
        of corners.
        """
        laid: list[IntArray] = []
        for depth, of_level in enumerate(cells):
            is_child = self.divides(ancestor_keys(of_level), depth + 1)
            corners = kernels.spread_keys(of_level[is_child], -1, 2)
            laid.append(_with_parents(corners, laid))
        return [*laid, _with_parents(base, laid)]

    def cells_above(self, finest: IntArray) -> list[IntArray]:
        """Return some of the finest cells, and their ancestors up to the base."""
        cells = [finest]
        for _ in range(self.levels):
            cells.append(unique_keys(ancestor_keys(cells[-1])))
        return cells


def _with_parents(corners: IntArray, finer: list[IntArray]) -> IntArray:
    """Return corners, and the parents of those of the next finer level."""
    return kernels.unite_keys(corners, kernels.parent_keys(finer[-1])) if finer else corners
