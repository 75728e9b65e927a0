"""A surface that ends on the border of the part that was asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from hpcapp.applications.surface.attributes.search import evaluate_blocks
from hpcapp.applications.surface.boundary.support import Support
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.job.outcome import Reconstruction
from hpcapp.applications.surface.job.scan import Loaded
from hpcapp.applications.surface.stitching.surface import Surface
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.regions.clipping import Cutter, clip_mesh, find_beyond
from hpcapp.geometry.regions.region import say_place
from hpcapp.io.meshes.mesh_stream import MeshStream
from hpcapp.parts.crop import Crop
from hpcapp.progress import StageClock
from hpccomponent.errors import InputError

_MEASURED = 1 << 16  # faces at most


def crop(asked: Crop, loaded: Loaded, result: Reconstruction, clock: StageClock) -> Reconstruction:
    """Cut a surface to what is asked for, and judge what is left; InputError if that is nothing."""
    cloud = loaded.cloud
    region = asked.find_region(loaded.crs.height_scale)
    with clock.stage("crop"), result.surface.open_stream() as stream:
        mesh = crop_stream(stream, region.localise(cloud.origin))
        if not len(mesh.faces):
            scales = (1.0, 1.0, loaded.crs.height_scale)
            low, high = ((end + cloud.origin) / scales for end in (cloud.low, cloud.high))
            raise InputError(
                f"no surface in {region}",
                f"the points around it lie from {say_place(low)} to {say_place(high)}",
            )
        facts = dict(result.facts)
        if "support" in facts:
            facts["support"] = asdict(_measure_support(mesh, cloud, facts))
    return replace(result, surface=Surface.of_mesh(mesh), facts=facts)


def _measure_support(mesh: Mesh, cloud: ArrangedCloud, facts: Mapping[str, Any]) -> Support:
    """Tell how much of a closed surface the points support, of what is left of it."""
    faces = mesh.faces[:: -(-len(mesh.faces) // _MEASURED)]
    a, b, c = (mesh.vertices[column] for column in faces.T)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    middles, reach = (a + b + c) / 3.0, float(facts["support"]["reach"])
    found = evaluate_blocks(cloud, cloud.take_columns, (), float(facts["spacing"]), middles)
    is_bare = found.nearest > reach
    share = 1.0 - float(areas[is_bare].sum() / areas.sum())
    return Support(share, float(found.nearest[is_bare].max(initial=0.0)), reach)


def crop_stream(stream: MeshStream, region: Cutter) -> Mesh:
    """Cut a mesh that may be larger than memory; what is left of it must fit.

    The region is in the local frame.
    """
    beyond = np.concatenate(
        [np.empty(0, np.uint8), *(find_beyond(b.positions, region) for b in stream.vertices())]
    )
    faces = np.concatenate(
        [
            np.empty((0, 3), np.int64),
            *(block[np.bitwise_and.reduce(beyond[block], axis=1) == 0] for block in stream.faces()),
        ]
    )
    used, corners = np.unique(faces, return_inverse=True)
    vertices, start = [np.empty((0, 3))], 0
    for block in stream.vertices():
        some = used[slice(*np.searchsorted(used, (start, start + len(block))))]
        vertices.append(block.positions[some - start])
        start += len(block)
    near = Mesh(np.concatenate(vertices), corners.reshape(-1, 3), stream.origin)
    return clip_mesh(near, region)
