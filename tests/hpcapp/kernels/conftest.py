"""Node values of a function that is known everywhere, brick by brick."""

from __future__ import annotations

import numpy as np
import pytest
from fixture_types import BrickFunction, BrickValues, Function
from numpy.typing import NDArray

from hpcapp.geometry.points import IntArray
from hpcapp.kernels.types.grid import BRICK, NODES, Grid


@pytest.fixture(scope="session")
def brick_values() -> BrickValues:
    """Turn a function of positions into one of bricks, with the outermost nodes outside."""

    def prepare(function: Function, grid: Grid) -> BrickFunction:
        def evaluate(places: IntArray) -> NDArray[np.float32]:
            steps = np.stack(np.meshgrid(*[np.arange(NODES)] * 3, indexing="ij"), axis=-1)
            nodes = BRICK * places[:, None, None, None, :] + steps
            values = function(grid.origin + grid.step * nodes).astype(np.float32)
            values[values == 0.0] = 1e-30
            outermost = ((nodes == 0) | (nodes == BRICK * np.array(grid.bricks))).any(axis=-1)
            return np.where(outermost, np.abs(values), values)

        return evaluate

    return prepare
