"""A square lattice seen from above."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass

_OFFSET = (0.3819660112501051, 0.4142135623730951)
"""Of the lattice, in cells: irrational, so that no line through a middle meets an edge of a mesh
whose coordinates are round."""


@dataclass(frozen=True, slots=True)
class Lattice:
    """Cells seen from above, row by row.

    `low` is the corner of the first cell; its shape is rows (along y) and columns (along x).
    """

    low: tuple[float, float]
    step: float
    shape: tuple[int, int]

    @classmethod
    def over(cls, low: FloatArray, high: FloatArray, step: float) -> Lattice:
        """Return the cells that cover a box, shape (2,) each corner."""
        corner = low - step * np.array(_OFFSET)
        columns, rows = (np.floor((high - corner) / step).astype(int) + 1).tolist()
        return cls((float(corner[0]), float(corner[1])), step, (rows, columns))

    @property
    def count(self) -> int:
        """How many cells there are."""
        return self.shape[0] * self.shape[1]

    @property
    def middles(self) -> FloatArray:
        """The middles of the cells, shape (rows, columns, 2)."""
        rows, columns = np.indices(self.shape)
        middles = np.stack([columns, rows], axis=-1).astype(np.float64) + 0.5
        return np.array(self.low) + self.step * middles

    def in_cells(self, positions: FloatArray) -> FloatArray:
        """Return x and y of positions in cells, shape (n, 2), from the first cell's middle."""
        cells: FloatArray = (positions[:, :2] - np.array(self.low)) / self.step - 0.5
        return cells
