"""A mesh cut to the part that is asked for."""

from __future__ import annotations

import numpy as np

from hpcapp.applications.points.crop import Crop
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.clipping import clip_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.region import say_place
from hpcapp.simplification.mesh import carry_nearest
from hpccomponent.errors import InputError


def crop_mesh(mesh: Mesh, crop: Crop, height_unit: float) -> Mesh:
    """Return the part of a mesh in a box or a ball, which ends on its border.

    Parameters
    ----------
    mesh : Mesh
        With a face.
    crop : Crop
        In the coordinates of the mesh.
    height_unit : float
        How long a unit of z is, in units of x and y.

    Returns
    -------
    Mesh
        Its vertices carry what the nearest ones of `mesh` do.

    Raises
    ------
    InputError
        Nothing of it is there.
    """
    if not crop.has_region:
        return mesh
    region = crop.find_region(height_unit)
    scales = region.scales
    local = region.localise(mesh.origin * scales)
    vertices, faces = clip_mesh(mesh.vertices * scales, mesh.faces, local)
    if not len(faces):
        low, high = (end + mesh.origin for end in bound_points(mesh.vertices))
        raise InputError(
            f"no surface in {region}", f"the mesh lies from {say_place(low)} to {say_place(high)}"
        )
    return carry_nearest(Mesh(vertices / scales, np.ascontiguousarray(faces), mesh.origin), mesh)
