"""Heights of a terrain from Python, as ``hpcapp heights`` writes them."""

from __future__ import annotations

from os import PathLike

from numpy.typing import ArrayLike

from hpcapp.api.comparison import take_epoch
from hpcapp.api.mesh import Mesh
from hpcapp.applications.heights.grid import HeightGrid, grid_heights
from hpcapp.geometry.points import PointCloud
from hpccomponent.ranges import check_range


def heights(
    terrain: Mesh | PointCloud | ArrayLike | str | PathLike[str], *, step: float | None = None
) -> HeightGrid:
    """Return the heights of a terrain in square cells.

    Parameters
    ----------
    terrain : Mesh, PointCloud, array_like of shape (n, 3), str or PathLike
        A mesh or points, z up; or the file of them.
    step : float, optional
        Width of a cell; by default what points or faces are dense enough for, rounded up.

    Raises
    ------
    InputError
        The file cannot be read, or no cell has a height.
    UsageError
        There are too many cells, or the file's suffix is unknown.

    Examples
    --------
    >>> import hpcapp, numpy as np
    >>> slope = np.random.default_rng(0).random((20000, 3)) * [10.0, 10.0, 0.0]
    >>> slope[:, 2] = 0.5 * slope[:, 0]
    >>> grid = hpcapp.heights(slope, step=1.0)
    >>> grid.values[0].round(2)
    array([0.25, 0.75, 1.25, 1.75, 2.25, 2.75, 3.25, 3.75, 4.25, 4.75])
    """
    if step is not None:
        check_range("step", step, 0.0, is_open=True)
    return grid_heights(take_epoch(terrain, "terrain"), step)
