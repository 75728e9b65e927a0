"""How far light meshes are off, beside Open3D's: HPCAPP_DATA=DIR simplification.py [-o FILE].

Both simplify each mesh of the folder ``tuning`` to a tenth of its triangles. Distances are from
points on either surface, and its vertices, to the other one, in hundredths of the diagonal.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import open3d
from tables import Row, parser_of, write_table

from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.io import read_mesh
from hpcapp.io.points.mesh_samples import sample_faces
from hpcapp.simplification.mesh import simplify_mesh
from hpcapp.simplification.target import Target

COLUMNS = [
    "mesh", "faces", "left", "manifold", "mean, %", "largest, %", "s",
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
    asked = parser_of(__doc__).parse_args()
    rows: list[Row] = []
    for path in sorted(Path(os.environ["HPCAPP_DATA"]).glob("tuning/meshes/*.ply")):
        mesh = read_mesh(path)
        faces = len(mesh.faces) // 10
        ours = measure(mesh, faces, lambda mesh, faces: simplify_mesh(mesh, Target(faces)))
        rows.append([path.stem, len(mesh.faces), *ours, *measure(mesh, faces, simplify_peer)])
        print(*rows[-1], flush=True)
    title = "Light meshes, a tenth of the triangles, beside Open3D's"
    write_table(asked.output, title, COLUMNS, rows)


if __name__ == "__main__":
    main()
