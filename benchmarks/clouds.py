"""The clouds that reconstructions are compared on: python benchmarks/clouds.py FOLDER [NAME ...].

Every cloud is fixed by its name: the same seed, the same points. They are made on demand and
kept in a folder. Scans of real objects join in where the environment variable HPCAPP_DATA names
the folder that holds them.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from hpcapp.applications.compare.truth import MeshTruth, ShapeTruth, Truth, read_mesh_at
from hpcapp.io import write_points
from hpcapp.lab.simulate.scanner import simulate_scan
from hpcapp.lab.simulate.settings import ScanSettings
from hpcapp.lab.simulate.shapes import find_shape
from hpccomponent.errors import UsageError


@dataclass(frozen=True, slots=True)
class SimulatedCloud:
    """A scan of an analytic shape."""

    name: str
    group: str
    shape: str
    settings: ScanSettings

    def place(self, folder: Path) -> Path:
        """Return the file that holds the points, made if it is not there."""
        path = folder / f"{self.name}.ply"
        if not path.exists():
            folder.mkdir(parents=True, exist_ok=True)
            write_points(path, simulate_scan(find_shape(self.shape), self.settings))
        return path


@dataclass(frozen=True, slots=True)
class FileCloud:
    """A cloud and its truth, a mesh, in the folder that HPCAPP_DATA names."""

    name: str
    group: str
    file: str
    truth_file: str

    def place(self, folder: Path) -> Path:  # noqa: ARG002  (it takes what a SimulatedCloud takes)
        """Return the file that holds the points."""
        return _given_file(self.file)


Cloud = SimulatedCloud | FileCloud

GROUPS: Mapping[str, str] = {
    "clean": "no noise",
    "noise": "0.05, 0.2 and 0.5 % of the diagonal",
    "pose": "views registered wrongly",
    "sparse": "5,000 points",
    "uneven": "density falls to a thirtieth",
    "outliers": "3 % wrong points",
    "flipped": "5 % of the normals have the wrong sign",
    "missing": "regions without points",
    "thin": "sheets one per cent of the diagonal apart, thin limbs",
    "large": "a million exact points",
    "relief": "detail of several sizes on a smooth body",
    "sharp": "machine parts with straight and curved edges, holes and fins",
    "correlated": "depth errors that are smooth along the surface, each view its own",
    "real": "scans of real objects",
    "scans": "simulated scans of real objects' meshes, by name only",
}


def _simulated() -> list[SimulatedCloud]:
    """Return every simulated cloud; each one's seed is its place in the list."""
    clouds: list[SimulatedCloud] = []

    def add(group: str, shape: str, label: str, **settings: float | int | str) -> None:
        chosen = ScanSettings(**{"seed": 1000 + len(clouds), **settings})  # type: ignore[arg-type]
        clouds.append(SimulatedCloud(f"{shape}-{label}", group, shape, chosen))

    for shape in ("knot", "bracket", "fingers", "frame", "torus"):
        add("clean", shape, "clean")
    for shape in ("knot", "bracket", "fingers", "frame"):
        for noise in (0.0005, 0.002, 0.005):
            add("noise", shape, f"noise{noise:g}", noise=noise)
    for shape in ("knot", "fingers", "bracket"):
        add("pose", shape, "pose", noise=0.0005, pose_error=0.001)
    for shape in ("knot", "bracket", "fingers", "frame"):
        add("sparse", shape, "sparse", points=5000, noise=0.001)
    for shape in ("torus", "fingers", "bracket"):
        add("uneven", shape, "uneven", density_ratio=30.0, noise=0.0005)
    for shape in ("box", "fingers", "frame"):
        add("outliers", shape, "outliers", outliers=0.03, noise=0.001)
    for shape in ("torus", "bracket"):
        add("flipped", shape, "flipped", flipped=0.05, noise=0.001)
    for shape in ("ellipsoid", "bracket", "frame"):
        add("missing", shape, "missing", missing=8, dropout=0.1, noise=0.001)
    add("thin", "plate", "thin", normals="exact", noise=0.0005)
    add("thin", "plates", "thin", views=0, normals="exact", noise=0.0005)
    add("thin", "ring", "thin", noise=0.001)
    add("thin", "shaft", "thin", noise=0.002)
    add("large", "torus", "1M", points=1_000_000, views=0, normals="exact")
    for shape in ("boulder", "studded", "bust"):
        add("relief", shape, "clean")
        add("relief", shape, "noise0.001", noise=0.001)
    for shape in ("gear", "heatsink", "flange", "manifold"):
        add("sharp", shape, "clean")
        add("sharp", shape, "noise0.0005", noise=0.0005)
    for shape in ("torus", "bracket", "bust"):
        add("correlated", shape, "drift", noise=0.0005, drift=0.001, correlation=0.03)
    return clouds


_REAL = (
    FileCloud("bunny-36k", "real", "bunny_35947.ply", "bunny_zipper_mesh.ply"),
    FileCloud("bunny-263k", "real", "bunny_263256.ply", "bunny_zipper_mesh.ply"),
    FileCloud("rocker-clean", "real", "rocker_arm_scan_clean.ply", "rocker_arm_mesh.ply"),
    FileCloud("rocker-noisy", "real", "rocker_arm_scan_noisy.ply", "rocker_arm_mesh.ply"),
)


def _scans() -> list[FileCloud]:
    """Return the scans MESH__LEVEL of meshes MESH in the folder that HPCAPP_DATA names, if any."""
    folder = Path(os.environ.get("HPCAPP_DATA", ""), "tuning")
    return [
        FileCloud(
            path.stem,
            "scans",
            f"tuning/scans/{path.name}",
            f"tuning/meshes/{path.stem.split('__')[0]}.ply",
        )
        for path in sorted((folder / "scans").glob("*.ply"))
    ]


_EVERY: tuple[Cloud, ...] = (*_simulated(), *_REAL, *_scans())
CLOUDS: Mapping[str, Cloud] = {cloud.name: cloud for cloud in _EVERY}


def find_clouds(names: list[str]) -> list[Cloud]:
    """Return the clouds that `names` (of clouds or of groups) stand for, in their fixed order.

    No names mean all but the scans, the real ones only where HPCAPP_DATA is set. Raise UsageError
    where a name is neither a cloud nor a group.
    """
    for name in names:
        if name not in CLOUDS and name not in GROUPS:
            raise UsageError(
                f"there is no cloud or group named {name!r}",
                f"choose from {', '.join((*GROUPS, *CLOUDS))}",
            )
    if names:
        return [c for c in CLOUDS.values() if c.name in names or c.group in names]
    given = {"real"} if "HPCAPP_DATA" in os.environ else set()
    left_out = {"real", "scans"} - given
    return [c for c in CLOUDS.values() if c.group not in left_out]


def open_truth(cloud: Cloud) -> Truth:
    """Return what the cloud is a scan of."""
    if isinstance(cloud, SimulatedCloud):
        return ShapeTruth(find_shape(cloud.shape))
    return MeshTruth(read_mesh_at(_given_file(cloud.truth_file)))


def _given_file(name: str) -> Path:
    """Return a file in the folder that HPCAPP_DATA names."""
    folder = os.environ.get("HPCAPP_DATA")
    if folder is None:
        raise UsageError("HPCAPP_DATA is not set", f"let it name the folder that holds {name}")
    path = Path(folder) / name
    if not path.exists():
        raise UsageError(f"{path} is not there", "let HPCAPP_DATA name the folder that holds it")
    return path


def main() -> None:
    """Make clouds and say where they are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", help="clouds or groups; all by default")
    args = parser.parse_args()
    for cloud in find_clouds(args.names):
        print(f"{cloud.group:9} {cloud.name:20} {cloud.place(args.folder)}", flush=True)


if __name__ == "__main__":
    main()
