"""How well the bare ground is found where no class tells it: ground.py [CLASSIFIED.las ...].

Of classified files, one line each: of the points of class 2 how many are left out, of the others
how many are kept, how many of all are either; and how far those others are above or below the
surface between points of class 2, as median and 95 % of their distances in metres: a file of a
survey leaves ground unclassified, too.

Without files one line for each scene, scanned from an aeroplane, and share of wrong returns: of the
points that are kept, how many are ground; of the ground, how much is kept; and how far the mesh of
them is from the true ground, as RMS in metres.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import cKDTree

import hpcapp
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import open_points, read_whole
from hpcapp.io.crs import METRES
from hpcapp.io.points.mesh_points import slice_cloud
from hpcapp.io.points.mesh_samples import sample_faces
from hpcapp.lab.simulate.raw.scan import RawScan, RawSettings, scan_scene
from hpcapp.parts.ground import GROUND, take_ground

SCENES = ("terrain", "forest", "town", "yard")
_POINTS, _PLACES = 100_000, 400_000


def scan(scene: str, strays: float) -> tuple[RawScan, PointCloud]:
    """Return a scan, and its points, which have their class as ``truth`` alone."""
    raw = scan_scene(scene, "airborne", RawSettings(points=_POINTS, strays=strays))
    truth = raw.cloud.attributes["classification"]
    return raw, replace(raw.cloud, attributes={"truth": truth})


def measure_points(cloud: PointCloud) -> tuple[float, float]:
    """Return precision and recall of the ground."""
    source = take_ground(slice_cloud(Path("scan"), "simulated", cloud))
    truth = np.concatenate([part.attributes["truth"] for part in source.chunks(1 << 16)])
    is_ground = cloud.attributes["truth"] == GROUND
    right = float((truth == GROUND).sum())
    return right / len(truth), right / float(is_ground.sum())


def measure_mesh(raw: RawScan, cloud: PointCloud) -> float:
    """Return how far the vertices of the mesh are from the true ground."""
    mesh = hpcapp.reconstruct(cloud, ground=True, executor="serial", attributes="none")
    is_ground = (raw.truth.attributes["classification"] == GROUND)[raw.truth.faces].all(axis=1)
    ground = replace(raw.truth, faces=raw.truth.faces[is_ground])
    vertices: FloatArray = np.array(mesh.vertices)
    places = sample_faces(ground, _PLACES)
    distances, rows = cKDTree(places.positions).query(vertices)
    assert places.normals is not None
    across = np.abs(np.einsum("nk,nk->n", vertices - places.positions[rows], places.normals[rows]))
    is_over = distances < 1.0  # the ground ends somewhere
    return float(np.sqrt((across[is_over] ** 2).mean()))


def measure_file(path: Path) -> str:
    """Compare what the cloth keeps with the classes of a file, of which it is told nothing."""
    source = open_points(path)
    cloud = read_whole(source.isotropic())
    truth = cloud.attributes["classification"] == GROUND
    metres = METRES.get(source.unit or "m", 1.0)
    rows = {"truth": truth, "row": np.arange(len(cloud))}
    blind = PointCloud(metres * (cloud.positions + cloud.origin), attributes=rows)
    kept = np.zeros(len(cloud), np.bool_)
    for part in take_ground(slice_cloud(path, "classified", blind)).chunks(1 << 16):
        kept[part.attributes["row"]] = True
    fit = LinearNDInterpolator(blind.positions[truth][:, :2], blind.positions[truth][:, 2])
    more = blind.positions[kept & ~truth]
    away = np.abs(more[:, 2] - fit(more[:, :2]))
    return (
        f"{path.name}, {len(cloud):,} points, {truth.mean():.1%} of them ground: "
        f"left out {(truth & ~kept).sum() / truth.sum():.1%} of the ground, "
        f"kept {(kept & ~truth).sum() / (~truth).sum():.1%} of the others, "
        f"total {(kept != truth).mean():.1%}; these others lie {np.nanmedian(away):.2f} m from the "
        f"ground, 95 % within {np.nanquantile(away, 0.95):.2f}"
    )


def main() -> None:
    """Print the table."""
    if sys.argv[1:]:
        for name in sys.argv[1:]:
            print(measure_file(Path(name)))
        return
    for scene in SCENES:
        for strays in (0.0, 0.001, 0.01):
            raw, cloud = scan(scene, strays)
            precision, recall = measure_points(cloud)
            print(
                f"{scene}, {strays:.1%} of strays: precision {precision:.4f}, recall {recall:.4f}, "
                f"mesh {measure_mesh(raw, cloud):.3f} m from the ground"
            )


if __name__ == "__main__":
    main()
