"""The chain from the spacing of the points to the grid."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.resolution.chain import plan_grid
from hpcapp.kernels.types.grid import BRICK


@pytest.mark.parametrize("margin", [4, 32])
def test_the_grid_covers_the_cloud_with_cells_to_spare(margin: int) -> None:
    lowest, highest = np.array([97.0, -1.0, -0.2]), np.array([103.0, 1.0, 0.2])
    grid = plan_grid(lowest, highest, 128, margin)
    sides = BRICK * np.array(grid.bricks)
    assert sides[0] == 120 + 2 * margin
    assert sides.max() == sides[0]
    low, high = grid.origin, grid.origin + grid.step * sides
    assert (lowest - low > (margin - 0.5) * grid.step).all()
    assert (high - highest > (margin - 0.5) * grid.step).all()
