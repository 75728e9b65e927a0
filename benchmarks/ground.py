"""How well the bare ground is found where no class tells it: ground.py [FILE.las ...] [-o FILE].

One row for each scene, scanned from an aeroplane, and share of wrong returns; and for each
classified file of which class 2 is kept from it. Precision: of the points that are kept, how many
are ground. Recall: of the ground, how much is kept. How far the mesh is from the true ground, as
RMS in metres; of a file, how far the points that are kept and not of class 2 are from the surface
between those of class 2, as median and 95 %: a survey leaves ground unclassified, too.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import cKDTree
from tables import Row, parser_of, write_table

import hpcapp
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import open_points, read_whole
from hpcapp.io.crs import METRES
from hpcapp.io.points.mesh_points import slice_cloud
from hpcapp.io.points.mesh_samples import sample_faces
from hpcapp.lab.simulate.raw.scan import RawScan, RawSettings, scan_scene
from hpcapp.parts.ground import GROUND, take_ground

SCENES = ("terrain", "forest", "town", "yard")
CLASSIFIED = ("real/las/4_6_crop.las", "real/las/autzen_trim.laz")
"""In the folder that HPCAPP_DATA names: a mountain forest, the edge of a town."""
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


def measure_file(path: Path) -> Row:
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
    right = (kept & truth).sum()
    middle, most = np.nanquantile(away, (0.5, 0.95))
    shares = [round(float(right / one.sum()), 4) for one in (kept, truth)]
    return [f"{path.stem}, {len(cloud):,} points", "-", *shares, f"{middle:.2f}, {most:.2f}"]


def measure_scene(scene: str, strays: float) -> Row:
    """Measure a simulated scan with a share of wrong returns."""
    raw, cloud = scan(scene, strays)
    shares = [round(one, 4) for one in measure_points(cloud)]
    return [scene, strays, *shares, f"{measure_mesh(raw, cloud):.3f}"]


def main() -> None:
    """Measure, print and write the table."""
    parser = parser_of(__doc__)
    parser.add_argument("files", nargs="*", type=Path)
    asked = parser.parse_args()
    rows = [measure_scene(scene, strays) for scene in SCENES for strays in (0.0, 0.001, 0.01)]
    data = Path(os.environ["HPCAPP_DATA"])
    rows += map(measure_file, asked.files or [data / name for name in CLASSIFIED])
    print(*rows, sep="\n")
    title = "Bare ground that no class tells: points, and how far they or their mesh are off"
    columns = ("scene", "wrong returns", "precision", "recall", "metres off")
    write_table(asked.output, title, columns, rows)


if __name__ == "__main__":
    main()
