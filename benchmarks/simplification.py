"""How far light meshes are off, beside Open3D's: simplification.py MESH=FACES ... [-o FILE].

Both simplify each mesh to the same number of triangles. Distances are from points on either
surface, and its vertices, to the other one, in hundredths of the diagonal of the mesh.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import open3d
from tables import write_table

from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.io import read_mesh
from hpcapp.io.points.mesh_samples import sample_faces
from hpcapp.simplification.mesh import simplify_mesh
from hpcapp.simplification.target import Target

COLUMNS = [
    "mesh", "faces", "asked", "left", "manifold", "mean, %", "largest, %", "s",
    "Open3D left", "Open3D manifold", "Open3D mean, %", "Open3D largest, %", "Open3D s",
]  # fmt: skip
SAMPLES = 200_000


def simplify_peer(mesh: Mesh, faces: int) -> Mesh:
    """Return Open3D's light mesh."""
    given = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices),
        open3d.utility.Vector3iVector(mesh.faces.astype(np.int32)),
    )
    light = given.simplify_quadric_decimation(faces)
    return Mesh(np.array(light.vertices), np.array(light.triangles, np.int64))


def sample(mesh: Mesh) -> FloatArray:
    """Return points spread evenly over the faces, and the vertices."""
    return np.concatenate([sample_faces(mesh, SAMPLES).positions, mesh.vertices])


def measure_distances(mesh: Mesh, light: Mesh) -> tuple[float, float]:
    """Return the mean and the largest distance between two meshes, in per cent of the diagonal."""
    centre = mesh.vertices.mean(axis=0)
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    scaled = [Mesh((one.vertices - centre) / diagonal, one.faces) for one in (mesh, light)]
    means, largest = [], []
    for here, there in (scaled, scaled[::-1]):
        scene = open3d.t.geometry.RaycastingScene()
        corners, places = (np.float32(one) for one in (there.vertices, sample(here)))
        scene.add_triangles(
            open3d.core.Tensor.from_numpy(corners),
            open3d.core.Tensor.from_numpy(there.faces.astype(np.uint32)),
        )
        found = scene.compute_distance(open3d.core.Tensor.from_numpy(places)).numpy()
        means.append(found[:SAMPLES].mean())
        largest.append(found.max())
    return 100.0 * float(np.mean(means)), 100.0 * float(max(largest))


def measure(
    mesh: Mesh, faces: int, simplify: Callable[[Mesh, int], Mesh]
) -> list[str | int | float]:
    """Return what a light mesh comes to."""
    start = time.perf_counter()
    light = simplify(mesh, faces)
    spent = time.perf_counter() - start
    found = check_mesh(light)
    is_manifold = found.edge_manifold and found.vertex_manifold
    mean, largest = measure_distances(mesh, light)
    said = "yes" if is_manifold else "no"
    return [len(light.faces), said, round(mean, 5), round(largest, 4), round(spent, 2)]


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", nargs="+", metavar="MESH=FACES")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    rows: list[list[str | int | float]] = []
    for given in options.meshes:
        name, asked = given.rsplit("=", 1)
        mesh, faces = read_mesh(name), int(asked)
        ours = measure(mesh, faces, lambda mesh, faces: simplify_mesh(mesh, Target(faces)))
        peer = measure(mesh, faces, simplify_peer)
        rows.append([Path(name).stem, len(mesh.faces), faces, *ours, *peer])
        print(*rows[-1], flush=True)
    if options.output is None:
        return
    write_table(
        options.output,
        "Light meshes beside Open3D's",
        COLUMNS,
        rows,
        f"python benchmarks/simplification.py {' '.join(Path(m).name for m in options.meshes)}",
        [
            "Mean and largest distance between the surfaces, both ways, in hundredths of the "
            "diagonal; Open3D's `simplify_quadric_decimation` got the same mesh in memory."
        ],
        f"{platform.machine()}, shared with other work",
    )


if __name__ == "__main__":
    main()
