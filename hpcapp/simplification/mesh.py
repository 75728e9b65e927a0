"""Fewer triangles for a mesh that stays closed and manifold."""

from __future__ import annotations

from hpcapp.applications.surface.stitching.topology import check_mesh, require_closed
from hpcapp.geometry.mesh import Mesh
from hpcapp.simplification.parts import collapse
from hpcapp.simplification.target import Target


def simplify_mesh(mesh: Mesh, target: Target) -> Mesh:
    """Simplify a mesh in memory, closed or open, by `kernels.portable.mesh.collapse`.

    It stays manifold and closed if it is; its normals, colours and attributes are those of the
    nearest vertices before. Edges go in the order of their errors; each distance of a new vertex
    from the planes of the faces that it stands for is below `Target.tolerance`. Errors are those of
    `Target.check` and `require_closed`.
    """
    target.check()
    if not target.is_something or len(mesh.faces) <= (target.faces or 0):
        return mesh
    light, _ = collapse(mesh, target, keeps_border=False)
    require_closed(lambda: check_mesh(mesh), check_mesh(light))
    return light
