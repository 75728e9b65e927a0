#!/usr/bin/env python3
"""Show how far a texture from photographs is from the paint that they were made of.

    benchmarks/photographs.py [--photos 12] [--width 800] [--pixels 1024] [-o FILE]

A ground and three balls in front of each other (`tests/helpers/painted_scene.py`), photographs with
Brown's distortion and exposures that differ by up to 1.5. Colours are 0 to 255; a step is how much
the difference of two texels side by side is off, and `other paint` the texels that have the hue of
another thing. `mesh` is the scene's own, with the cameras as they are or turned by a pixel;
`reconstruct` the whole command from points without colours.
"""

from __future__ import annotations

import logging
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
from click.testing import CliRunner
from PIL import Image
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from painted_scene import (
    find_things,
    make_mesh,
    make_shots,
    paint,
    tell_things,
    to_srgb,
    write_shots,
)
from tables import parser_of, write_table

from hpcapp.applications.surface.cli.command import reconstruct
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, ByteArray, FloatArray, PointCloud
from hpcapp.io import write_points
from hpcapp.io.points.mesh_samples import sample_faces
from hpcapp.texture.atlas import unwrap
from hpcapp.texture.photos.folder import find_photos
from hpcapp.texture.photos.painting import paint as paint_by
from hpcapp.texture.request import Photo
from hpcapp.texture.texels import cover

Row = tuple[str, str, str, str, str, str, str]
COLUMNS = ("what", "seen", "median", "0.99", "step 0.99", "other paint", "seconds")
POINTS, FACES = 60_000, 6000


def judge(
    name: str, mesh: Mesh, places: FloatArray, colours: ByteArray, is_seen: BoolArray, took: float
) -> Row:
    """Compare the texels (p, p, 3) of a mesh whose vertices lie at places (v, 2) with the truth."""
    pixels = len(colours)
    off = np.full((pixels * pixels, 3), np.nan)
    others = total = 0
    for texels in cover(places, mesh.faces, pixels):
        on, things = find_things(texels.blend(mesh.vertices, mesh.faces))
        seen = is_seen[texels.cells]
        shown = colours.reshape(-1, 3)[texels.cells].astype(float)
        off[texels.cells[seen]] = (shown - to_srgb(paint(on, things)))[seen]
        others += int((tell_things(shown) != things)[seen].sum())
        total += len(seen)
    square = off.reshape(pixels, pixels, 3)
    steps = [np.abs(np.diff(square, axis=axis)).max(axis=2).ravel() for axis in (0, 1)]
    errors = np.abs(off[~np.isnan(off[:, 0])]).max(axis=1)
    step = np.nanquantile(np.concatenate(steps), 0.99)
    return (
        name, f"{len(errors) / total:.3f}", f"{np.median(errors):.2f}",
        f"{np.quantile(errors, 0.99):.2f}", f"{step:.2f}", str(others), f"{took:.1f}",
    )  # fmt: skip


def turn(photos: Sequence[Photo], pixels: float) -> tuple[Photo, ...]:
    """Return photographs whose cameras are turned by so many pixels, at random."""
    rng = np.random.default_rng(1)
    return tuple(
        replace(one, camera=replace(one.camera, rotation=(
            Rotation.from_rotvec(rng.normal(size=3) * pixels / one.lens.focal[0]).as_matrix()
            @ one.camera.rotation
        )))
        for one in photos
    )  # fmt: skip


def measure_mesh(photos: Sequence[Photo], pixels: int) -> Iterator[Row]:
    """Paint the scene's own mesh."""
    mesh, _ = make_mesh()
    assert mesh.normals is not None
    atlas = unwrap(mesh, pixels)
    cut = Mesh(mesh.vertices[atlas.sources], atlas.faces, normals=mesh.normals[atlas.sources])
    for name, some in (("mesh", photos), ("mesh, cameras 1 pixel off", turn(photos, 1.0))):
        start = perf_counter()
        painted = paint_by(cut, atlas.places, pixels, some, lambda _: None)
        took = perf_counter() - start
        square = painted.colours.reshape(pixels, pixels, 3)
        yield judge(name, cut, atlas.places, square, painted.is_seen, took)


def measure_job(folder: Path, cameras: Path, pixels: int) -> Row:
    """Reconstruct points without colours, and read what is written."""
    fine, _ = make_mesh(160)
    samples = sample_faces(fine, POINTS, 0)
    write_points(folder / "scan.ply", PointCloud(samples.positions, samples.normals))
    start = perf_counter()
    done = CliRunner().invoke(reconstruct, [
        str(folder / "scan.ply"), "-o", str(folder / "mesh.obj"), "--faces", str(FACES),
        "--texture", str(pixels), "--images", str(folder / "images"), "--viewpoint", str(cameras),
    ], catch_exceptions=False)  # fmt: skip
    took = perf_counter() - start
    assert done.exit_code == 0, done.output
    rows: dict[str, list[list[str]]] = {"v": [], "vt": [], "f": []}
    for line in (folder / "mesh.obj").read_text().splitlines():
        kind, _, rest = line.partition(" ")
        rows.get(kind, []).append(rest.split())
    corners = np.array([[word.split("/")[:2] for word in face] for face in rows["f"]], int) - 1
    places = np.array(rows["vt"], float) * (1.0, -1.0) + (0.0, 1.0)
    sources = np.zeros(len(places), int)
    sources[corners[..., 1]] = corners[..., 0]
    mesh = Mesh(np.array(rows["v"], float)[:, :3][sources], corners[..., 1])
    colours = np.asarray(Image.open(folder / "mesh_colours.png"))
    return judge("reconstruct", mesh, places, colours, np.ones(colours.size // 3, bool), took)


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--photos", type=int, default=12)
    parser.add_argument("--width", type=int, default=800)
    parser.add_argument("--pixels", type=int, default=1024)
    asked = parser.parse_args()
    logging.disable()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shots = make_shots(asked.photos, (asked.width, asked.width * 3 // 4))
        cameras = write_shots(folder / "images", shots)
        photos = find_photos(str(folder / "images"), [str(cameras)])
        rows = [*measure_mesh(photos, asked.pixels), measure_job(folder, cameras, asked.pixels)]
    for row in (COLUMNS, *rows):
        print(f"{row[0]:28}" + "".join(f"{value:>13}" for value in row[1:]))
    title = "Textures from photographs of known paint: errors of the texels seen, of 255"
    notes = [
        f"{asked.photos} photographs of {asked.width} x {asked.width * 3 // 4}, {asked.pixels:,} x "
        f"{asked.pixels:,} texels; exposures differ by up to 1.5.",
        "`step 0.99`: how much the difference of texels side by side is off, in one of 100. "
        "`other paint`: texels with the hue of another thing.",
        "`reconstruct` counts all texels, those that no photograph shows, too.",
    ]
    write_table(asked.output, title, COLUMNS, rows, notes)


if __name__ == "__main__":
    main()
