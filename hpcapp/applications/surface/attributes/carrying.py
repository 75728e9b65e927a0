"""A mesh whose vertices carry what the points near them have.

Vertices are looked up block by block, as they are written: a block depends on where its vertices
are and on nothing else, so that tiles and workers give the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import field, replace
from typing import TYPE_CHECKING

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.geometry.support import SUPPORT
from hpcapp.geometry.vertex_normals import add_face_normals, scale_normals
from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream, make_array, scale_mesh_heights
from hpcapp.io.placement import Placement
from hpccomponent.dataclass import dataclass

if TYPE_CHECKING:
    from hpcapp.applications.surface.attributes.carry import Carried


Evaluate = Callable[[FloatArray], "Carried"]
"""Returns what places take from the points near them: see `AttributeField.evaluate`."""


@dataclass(frozen=True, slots=True, eq=False)
class Carrying:
    """What a mesh's vertices shall carry, and where the mesh is written.

    The `layout` has the points' colours and attributes, and no points; `evaluate` is None where
    nothing is taken from these. The `spacing` is None unless the support is asked for. Heights of
    another unit than x and y, which were scaled for the surface, get their own again by the `crs`.
    """

    layout: PointCloud
    evaluate: Evaluate | None = None
    spacing: float | None = None
    has_normals: bool = False
    crs: Crs = UNKNOWN
    placement: Placement = field(default_factory=Placement)

    @property
    def is_something(self) -> bool:
        """Whether the vertices get anything at all, or other heights."""
        has_columns = self.has_normals or self.evaluate is not None
        return has_columns or self.crs.height_scale != 1.0

    @property
    def names(self) -> list[str]:
        """What the vertices get, by the names that ``--attributes`` knows."""
        made = [("normals", self.has_normals), ("colours", self.layout.colours is not None)]
        names = [name for name, is_there in made if is_there]
        return [*names, *self.layout.attributes, *[SUPPORT] * (self.spacing is not None)]

    @property
    def columns(self) -> PointCloud:
        """Without points: all that the vertices get."""
        none, attributes = np.empty((0, 3)), dict(self.layout.attributes)
        if self.spacing is not None:
            attributes[SUPPORT] = np.empty(0, np.float32)
        normals = none if self.has_normals else None
        return PointCloud(none, normals, self.layout.colours, attributes)

    def with_attributes(self, names: Collection[str]) -> Carrying:
        """Return the same with the attributes of some names alone."""
        spacing = self.spacing if SUPPORT in names else None
        kept = (name for name in self.layout.attributes if name in names)
        return replace(self, layout=_take(self.layout, kept), spacing=spacing)

    def to_stream(self, stream: MeshStream) -> MeshStream:
        """Return a mesh whose vertices carry it, in the input's coordinates.

        Vertices are looked up as they are asked for.
        """
        known = replace(stream, crs=self.crs)
        if not self.is_something:
            return known
        carried = replace(known, vertices=lambda: self._carry(stream), layout=self.columns)
        return scale_mesh_heights(carried, 1.0 / self.crs.height_scale)

    def to_tile(self, tile: MeshStream) -> MeshStream:
        """Return a tile of a mesh whose vertices carry it, but for normals.

        A vertex on a seam has faces in other tiles, too.
        """
        return replace(self, has_normals=False).to_stream(tile)

    def to_mesh(self, mesh: Mesh) -> Mesh:
        """Return a mesh in memory whose vertices carry it, in the input's coordinates."""
        if not self.is_something:
            return mesh
        stream = self.to_stream(as_stream(mesh))
        blocks = list(stream.vertices())
        layout = stream.layout
        normals = [block.normals for block in blocks if block.normals is not None]
        colours = [block.colours for block in blocks if block.colours is not None]
        return replace(
            mesh,
            vertices=np.concatenate([layout.positions, *(block.positions for block in blocks)]),
            origin=stream.origin,
            normals=np.concatenate(normals) if normals else None,
            colours=np.concatenate(colours) if colours else None,
            attributes={
                name: np.concatenate([block.attributes[name] for block in blocks])
                for name in layout.attributes
            },
        )

    def _carry(self, stream: MeshStream) -> Iterator[PointCloud]:
        """Yield the vertices with what they carry."""
        sums = _sum_normals(stream) if self.has_normals else None
        start = 0
        for block in stream.vertices():
            stop = start + len(block)
            if self.evaluate is not None:
                carried = self.evaluate(block.positions)
                block = _take(carried.points, self.layout.attributes)
                if self.spacing is not None:
                    support = (carried.nearest / self.spacing).astype(np.float32)
                    block = replace(block, attributes={**block.attributes, SUPPORT: support})
            if sums is not None:
                block = replace(block, normals=scale_normals(sums[:, start:stop]))
            yield block
            start = stop


def _take(points: PointCloud, names: Iterable[str]) -> PointCloud:
    """Return points with the attributes of some names."""
    return replace(points, attributes={name: points.attributes[name] for name in names})


NOTHING = Carrying(PointCloud(np.empty((0, 3))))
"""For meshes of which only the shape is asked for."""


def _sum_normals(stream: MeshStream) -> FloatArray:
    """Return the sums of the faces' normals at the vertices, shape (3, v), in a file."""
    sums = make_array((3, stream.vertex_count))
    for faces, corners in zip(stream.faces(), stream.corners(), strict=True):
        add_face_normals(sums, faces, corners)
    return sums
