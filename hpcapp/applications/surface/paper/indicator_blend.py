"""The paper's blend: at a node of the grid, the mean of the quadrics whose boxes hold it.

On the whole grid of nodes marching cubes find its surface.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.paper.kdtree import TreePatches
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import JobError, UsageError

#: Cells of empty margin on every side: iso-surfaces that leave the outermost boxes close in it.
MARGIN = 2
#: How near to a node's position, in cells, a box face counts as lying on it.
ON_FACE = 1e-9
#: Values below this fraction of the median magnitude count as zero.
NEARLY_ZERO = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class NodeGrid:
    """A grid with its first node at `low`, (3,), and so many nodes along x, y and z."""

    low: FloatArray
    step: float
    shape: tuple[int, int, int]


def plan_grid(patches: TreePatches, grid: int) -> NodeGrid:
    """Lay a grid of nodes over all boxes: `grid` cells along their longest side, and margins.

    UsageError where these are fewer than one, JobError where the boxes have no extent.
    """
    if grid < 1:
        raise UsageError(f"grid is {grid}", "give 1 cell or more, such as 64")
    low = patches.box_low.min(axis=0)
    size = patches.box_high.max(axis=0) - low
    step = float(size.max()) / grid
    if step <= 0.0:
        raise JobError("all points coincide, so there is no surface", "give a cloud with extent")
    nx, ny, nz = (int(cells) + 1 + 2 * MARGIN for cells in np.ceil(size / step - ON_FACE))
    return NodeGrid(low - MARGIN * step, step, (nx, ny, nz))


def sample_indicator_blend(
    patches: TreePatches,
    coefficients: FloatArray,
    nodes: NodeGrid,
    advance: Callable[[int, int], None],
) -> NDArray[np.float32]:
    """Sample the blend of the quadrics (p, 10), in patch coordinates, box by box.

    The values are algebraic, negative inside, and exactly 0 outside all boxes. `advance` is told
    (boxes done, boxes in all) now and then.

    Notes
    -----
    ``f(x) = sum_i I_i(x) f_i(x) / sum_i I_i(x)`` with I_i the indicator of box i, its faces
    included: a quadric in the inside of a box, a mean of up to eight on faces, edges and corners.
    It jumps at faces. Cost: one evaluation for each node of each box.
    """
    # (nx, ny, nz): the sum of the quadrics at each node, and how many boxes hold it
    total = np.zeros(nodes.shape, np.float32)
    boxes_here = np.zeros(nodes.shape, np.uint8)
    # (p, 3): the first node of each box along each axis, and the one behind the last
    begin = np.ceil((patches.box_low - nodes.low) / nodes.step - ON_FACE).astype(int)
    end = np.floor((patches.box_high - nodes.low) / nodes.step + ON_FACE).astype(int) + 1
    centers, scales = patches.centers, patches.scales
    for i in range(len(patches)):
        region = tuple(slice(a, b) for a, b in zip(begin[i], end[i], strict=True))
        # three axes of (a,), (b,), (c,): the box's nodes in patch coordinates
        u = [
            (nodes.low[k] + nodes.step * np.arange(begin[i, k], end[i, k]) - centers[i, k])
            / scales[i]
            for k in range(3)
        ]
        # (a, b, c): the quadric at these nodes, from (a, 1, 1), (1, b, 1) and (1, 1, c)
        total[region] += _evaluate_on_grid(coefficients[i], *np.ix_(*u))
        boxes_here[region] += 1
        if i % 64 == 63 or i + 1 == len(patches):
            advance(i + 1, len(patches))
    # (nx, ny, nz): the mean; nodes outside all boxes keep their exact 0
    np.divide(total, boxes_here, out=total, where=boxes_here > 0)
    return total


def settle_zeros(values: NDArray[np.float32]) -> None:
    """Move values that are 0 or nearly so to a small positive one, outside, in place.

    Marching cubes leaves open edges and triangles without area where nodes are exactly on the
    surface, and the blend makes whole regions of exact zeros outside the boxes. The small value is
    a ten-thousandth of the median magnitude of the values that are not zero.
    """
    magnitudes = np.abs(values)
    typical = np.median(magnitudes[magnitudes > 0.0]) if magnitudes.any() else 1.0
    tiny = np.float32(NEARLY_ZERO * typical)
    values[magnitudes < tiny] = tiny


def extract_iso_surface(
    values: NDArray[np.float32], nodes: NodeGrid, origin: FloatArray | None = None
) -> Mesh:
    """Extract the 0-level iso-surface, its faces anticlockwise as seen from outside.

    `values` has the grid's shape, negative inside; where one is exactly 0, the surface has open
    edges. The mesh's `origin`, (3,), is zero if left out. JobError where samples have one sign,
    hence no surface, or are NaN.
    """
    # skimage meshes NaN without a word.
    if not np.isfinite(values).all():
        raise JobError(
            "the implicit function is not finite everywhere", "look for a degenerate patch"
        )
    if not values.min() < 0.0 < values.max():
        raise JobError(
            "the implicit function has one sign on the whole grid, so the surface is empty",
            "use a finer grid, and make sure that the normals point out of the object",
        )
    from skimage import measure  # heavy

    marching_cubes: Any = measure.marching_cubes  # without type hints
    # Of its two windings "descent" is the one that shows its front to the positive side.
    vertices, faces, _, _ = marching_cubes(values, level=0.0, gradient_direction="descent")
    # (v, 3) in grid units, float32: in length units from here
    return Mesh(
        nodes.low + nodes.step * vertices.astype(np.float64),
        faces.astype(np.int64),
        np.zeros(3) if origin is None else origin,
    )


def _evaluate_on_grid(c: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    # (1, 1, c), then (1, b, c), then (a, b, c): Horner's scheme, one axis after the other
    along_z = c[0] + z * (c[3] + z * c[6])
    along_yz = y * (c[2] + y * c[5] + z * c[8]) + along_z
    values: FloatArray = x * (c[1] + x * c[4] + y * c[7] + z * c[9]) + along_yz
    return values
