"""One peer, one cloud, one mesh: peer_methods.py open3d:8|pymeshlab:8|pypoisson2:8 IN.ply OUT.ply.

Runs in an interpreter that has the peer; it needs nothing of ours.
"""

from __future__ import annotations

import sys
from pathlib import Path


def run_open3d(depth: int, source: str, target: str) -> None:
    """Reconstruct by Open3D's screened Poisson."""
    import open3d

    cloud = open3d.io.read_point_cloud(Path(source))
    mesh, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=depth)
    open3d.io.write_triangle_mesh(Path(target), mesh)


def run_pymeshlab(depth: int, source: str, target: str) -> None:
    """Reconstruct by pymeshlab's screened Poisson."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(source)
    meshes.generate_surface_reconstruction_screened_poisson(depth=depth)
    meshes.save_current_mesh(target, save_vertex_color=False, save_vertex_quality=False)


def run_pypoisson2(depth: int, source: str, target: str) -> None:
    """Reconstruct by PoissonRecon itself; Open3D reads and writes."""
    import numpy as np
    import open3d
    from poisson import poisson_reconstruction

    cloud = open3d.io.read_point_cloud(Path(source))
    points, normals = np.asarray(cloud.points), np.asarray(cloud.normals)
    vertices, faces, *_ = poisson_reconstruction(points, normals, depth=depth)
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(np.reshape(vertices, (-1, 3)).astype(float)),
        open3d.utility.Vector3iVector(np.reshape(faces, (-1, 3)).astype(np.int32)),
    )
    open3d.io.write_triangle_mesh(Path(target), mesh)


PEERS = {"open3d": run_open3d, "pymeshlab": run_pymeshlab, "pypoisson2": run_pypoisson2}


def main() -> None:
    """Run the peer that the command line names."""
    peer, source, target = sys.argv[1:4]
    name, depth = peer.split(":")
    PEERS[name](int(depth), source, target)


if __name__ == "__main__":
    main()
