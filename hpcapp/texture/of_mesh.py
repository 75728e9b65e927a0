"""The texture of a mesh that was there before it was light."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

from hpcapp.applications.surface.attributes.carry import AttributeField
from hpcapp.applications.surface.attributes.carrying import NOTHING
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import ByteArray, FloatArray, PointCloud
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.texture.bake import FineNormals, bake
from hpcapp.texture.request import Photo
from hpccomponent.limits import available_cores

log = logging.getLogger("hpcapp")


def texture_mesh(light: Mesh, fine: Mesh, pixels: int, photos: Sequence[Photo] = ()) -> MeshStream:
    """Return a light mesh with the look of the fine one, which lies in the same coordinates.

    Its colours are those of the photographs, and where these show nothing those of the fine mesh's
    vertices; it carries nothing else.
    """
    shape = replace(NOTHING, has_normals=True)
    threads = available_cores()
    normals = FineNormals(shape.to_stream(as_stream(fine)), pixels**2, threads)
    find = None
    if fine.colours is not None:
        vertices = PointCloud(fine.vertices, None, fine.colours)
        field = AttributeField(vertices, (), threads)

        def find(places: FloatArray) -> ByteArray:
            colours = field.evaluate(places + (light.origin - fine.origin)).points.colours
            assert colours is not None  # noqa: S101 - the vertices have them
            return colours

    bare = shape.to_mesh(Mesh(light.vertices, light.faces, light.origin))
    baked = bake(bare, normals, find, pixels, photos)
    log.info("%s", baked.describe())
    if baked.photos:
        log.info("%s", baked.describe_photos(None if find is None else "vertices"))
    return baked.mesh
