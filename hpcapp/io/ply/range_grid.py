"""The grid of a range scan in a PLY file, as the scans of Stanford's repository have it.

Lines of ``obj_info`` name the size of the grid; each row of element ``range_grid`` is a list of
the vertex in a cell, empty where the scanner saw nothing.

References
----------
"The Stanford 3D Scanning Repository", https://graphics.stanford.edu/data/3Dscanrep/
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from hpcapp.geometry.points import IntArray
from hpcapp.io.columns import Ragged
from hpcapp.io.ply.header import Header
from hpcapp.io.rows import is_count
from hpccomponent.decoding.claims import Claims
from hpccomponent.errors import InputError

GRID_LIST = "vertex_indices"
"""The list of a cell."""


def find_range_grid(header: Header) -> tuple[int, int] | None:
    """Return width and height of the grid; None without one of the size that is named."""
    element = header.find("range_grid")
    size = [header.remarks.get(name, "") for name in ("num_cols", "num_rows")]
    if element is None or not all(is_count(word) for word in size):
        return None
    has_list = any(p.name == GRID_LIST and p.dtype[0] in "iu" for p in element.properties)
    width, height = map(int, size)
    return (width, height) if has_list and 0 < width * height == element.count else None


def find_cells(lists: Iterable[Ragged], vertices: int, path: Path) -> IntArray:
    """Find the cell of each vertex, numbered row by row, -1 for none, from lists of the cells.

    These come some at a time. Raise InputError where one names a vertex that does not exist.
    """
    Claims(path).add(vertices * np.int64().nbytes, f"{vertices} vertices in a grid")
    cells = np.full(vertices, -1)
    first = 0
    for part in lists:
        named = part.values
        if ((named < 0) | (named >= vertices)).any():
            raise InputError(
                f"{path}: element 'range_grid' names vertices beyond the {vertices} of the file",
                "the file is damaged: export it again",
            )
        cells[named] = np.repeat(np.arange(first, first + len(part.lengths)), part.lengths)
        first += len(part.lengths)
    return cells
