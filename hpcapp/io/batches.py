"""Parts of a cloud, of any sizes, into parts of one size."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.types.points import PointCloud

__all__ = ["batch_points"]


def batch_points(parts: Iterable[PointCloud], rows: int) -> Iterator[PointCloud]:
    """Cut and join parts so that all but the last have so many points.

    Parameters
    ----------
    parts : iterable of PointCloud
        With the same attributes, one of them at least; some may be empty.

    Yields
    ------
    PointCloud
        One empty part where there are no points.
    """
    waiting: list[PointCloud] = []
    points = 0
    has_yielded = False
    for part in parts:
        waiting.append(part)
        points += len(part)
        if points < rows:
            continue
        whole, at = _join(waiting), 0
        while points - at >= rows:
            yield _cut(whole, at, at + rows)
            at, has_yielded = at + rows, True
        waiting, points = [_cut(whole, at, points)], points - at
    if points or not has_yielded:
        yield _join(waiting)


def _cut(cloud: PointCloud, start: int, stop: int) -> PointCloud:
    def cut(values: NDArray[Any]) -> NDArray[Any]:
        return values[start:stop]

    return PointCloud(
        cut(cloud.positions),
        None if cloud.normals is None else cut(cloud.normals),
        None if cloud.colours is None else cut(cloud.colours),
        {name: cut(column) for name, column in cloud.attributes.items()},
    )


def _join(clouds: list[PointCloud]) -> PointCloud:
    clouds = [cloud for cloud in clouds if len(cloud)] or clouds[:1]
    if len(clouds) == 1:
        return clouds[0]
    normals = [cloud.normals for cloud in clouds if cloud.normals is not None]
    colours = [cloud.colours for cloud in clouds if cloud.colours is not None]
    return PointCloud(
        np.concatenate([cloud.positions for cloud in clouds]),
        np.concatenate(normals) if normals else None,
        np.concatenate(colours) if colours else None,
        {
            name: np.concatenate([cloud.attributes[name] for cloud in clouds])
            for name in clouds[0].attributes
        },
    )
