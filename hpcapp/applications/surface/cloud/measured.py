"""What a method asks of a cloud before it chooses its cells: the spacing, and a sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hpcapp.applications.surface import kernels
from hpcapp.applications.surface.cloud.arrangement import choose_arrangement
from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.scale.local_scale import (
    HALVINGS,
    LocalScale,
    count_depth,
    count_scale,
    make_scale,
)
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.lattice import lay_lattice
from hpcapp.geometry.points import FloatArray, PointCloud
from hpccomponent.errors import InputError

Points = tuple[FloatArray, FloatArray]
"""Positions in length units of the input and unit normals, each of shape (n, 3)."""

_SAMPLED_POINTS = 15_000
SAMPLED_BOX = 24.0
"""Spacings: large against the cells of a probe."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What a method asks of a cloud.

    Parameters
    ----------
    scale : LocalScale
    sample : PointCloud
        Points by which the noise is judged, in the cloud's order.
    """

    scale: LocalScale
    sample: PointCloud

    @property
    def spacing(self) -> float:
        """Of the whole cloud, in length units of the input."""
        return self.scale.spacing


def measure_points(points: PointCloud) -> Measured:
    """Estimate the spacing of points in memory, and draw a sample of them.

    Parameters
    ----------
    points : PointCloud
        With normals.

    Raises
    ------
    InputError
        There are no normals, or all points are the same.
    """
    positions, normals = points.positions, points.normals
    if normals is None:
        raise InputError("the cloud has no normals", "give oriented points")
    scale = find_scale(positions)
    low, _ = bound_points(positions)

    def draw(one_in: int) -> Points:
        if one_in == 1:
            return positions, normals
        edge = SAMPLED_BOX * scale.spacing
        rows = kernels.sample_boxes(positions, lay_lattice(low, edge), edge, one_in)
        return positions[rows], normals[rows]

    return Measured(scale, PointCloud(*draw_sample(draw, len(points))))


def find_scale(positions: FloatArray) -> LocalScale:
    """Find how the spacing of points in memory changes from place to place.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        In length units of the input.

    Raises
    ------
    InputError
        All points are the same.
    """
    spacing, lattice = estimate_spacing(positions), choose_arrangement(*bound_points(positions))
    edge = lattice.edge * 2.0**-HALVINGS
    counted = count_scale(positions, lattice.origin, edge, count_depth(edge, spacing))
    return make_scale(spacing, lattice.origin, edge, [counted])


def first_share(points: int) -> int:
    """Return how many boxes make one sampled, to begin with; of a small cloud all points are.

    Parameters
    ----------
    points : int
        Of the cloud.

    Returns
    -------
    int
        At least 1.
    """
    return max(points // _SAMPLED_POINTS, 1)


def draw_sample(draw: Callable[[int], Points], points: int) -> Points:
    """Draw a sample of boxes that holds enough points to find the noise by.

    Parameters
    ----------
    draw : callable
        Given how many boxes of edge `SAMPLED_BOX` make one sampled, returns the points in them, in
        the cloud's order.
    points : int
        Of the cloud.

    Returns
    -------
    positions, normals : ndarray of float64, shape (n, 3)
        Of about 15,000 points; of a cloud in few boxes more, and all of a small one.
    """
    one_in = first_share(points)
    while one_in > 1:
        sample = draw(one_in)
        if len(sample[0]) > _SAMPLED_POINTS // 4:
            return sample
        # The points lie in few boxes, so that few of these are in the sample.
        one_in //= 8
    return draw(1)
