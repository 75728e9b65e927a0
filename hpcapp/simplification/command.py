"""The verb ``simplify``; imported for every ``--help``: nothing heavy is imported."""

from __future__ import annotations

import logging
from pathlib import Path

import click

from hpcapp.applications.points.command import AROUND, BOX, POLYGON
from hpcapp.applications.points.crop import parse_crop
from hpcapp.geometry.axis_names import AXES
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import UsageError

log = logging.getLogger("hpcapp")

ORIGIN = click.option(
    "--origin",
    default="auto",
    show_default=True,
    metavar="WHERE",
    help="What is subtracted from the coordinates: auto, in .glb, .obj, .stl and .3mf what makes "
    "those of a map fit single precision; keep, nothing; or X,Y,Z. A file beside MESH, "
    ".origin.json, brings it back.",
)
UP = click.option(
    "--up",
    type=click.Choice(AXES),
    help="The axis that points up, for .glb and .3dtiles.  [default: z, or y of what stands on a "
    "flat base there]",
)


@click.command(
    cls=Verb,
    examples=[
        (
            "hpcapp simplify mesh.ply -o light.glb --faces 50000",
            "Leave 50,000 triangles, for a viewer.",
        ),
        (
            "hpcapp simplify mesh.ply -o light.ply --tolerance 0.002",
            "Leave what keeps the surface within 0.002 of where it is.",
        ),
        (
            "hpcapp simplify mesh.ply -o light.glb --size 20MB",
            "Leave as many triangles as a file of 20 MB holds.",
        ),
    ],
)
@click.argument(
    "mesh", type=click.Path(dir_okay=False, path_type=Path), help="A .ply, .obj, .off or .stl."
)
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="MESH",
    help="Mesh to write: .ply, .obj, .glb, .vtp, .3mf, .off, .stl, .tiles or .3dtiles; - writes a "
    "PLY to standard output.",
)
@BOX
@AROUND
@POLYGON
@click.option("--faces", type=click.IntRange(4), metavar="N", help="Simplify it to N triangles.")
@click.option(
    "--tolerance",
    type=click.FloatRange(0, min_open=True),
    metavar="LENGTH",
    help="Simplify it while its surface moves by less, in its own units.",
)
@click.option("--size", metavar="BYTES", help="Simplify it to a file of at most that: 20MB.")
@ORIGIN
@UP
def simplify(
    mesh: Path,
    output: str,
    box: str | None,
    around: str | None,
    polygon: str | None,
    faces: int | None,
    tolerance: float | None,
    size: str | None,
    origin: str,
    up: str | None,
) -> None:
    """Simplify a mesh, or a part, with all that its vertices carry."""
    from dataclasses import replace

    from hpcapp.io import find_mesh_crs, find_mesh_up, read_mesh, write_mesh
    from hpcapp.io.meshes.mesh_stream import as_stream
    from hpcapp.io.output import open_output
    from hpcapp.io.placement import Placement, parse_origin
    from hpcapp.simplification.mesh import Target, simplify_mesh
    from hpcapp.simplification.size import fit_mesh, read_size

    target, crop = Target(faces, tolerance), parse_crop(box, around, polygon)
    if not target.is_something and size is None and not crop.has_region:
        raise UsageError("nothing to simplify to", "give --faces, --tolerance or --size")
    target.check()
    parse_origin(origin)
    most_bytes = None if size is None else read_size(size, output)
    with open_output(output, [mesh]) as path:
        crs = find_mesh_crs(mesh)
        placement = Placement(parse_origin(origin), up or find_mesh_up(mesh))
        whole = read_mesh(mesh)
        light = simplify_mesh(crop.cut(whole, crs.height_scale, str(mesh)), target)
        if most_bytes is not None:
            light = fit_mesh(light, most_bytes, path.suffix, crs, placement)
        write_mesh(path, replace(as_stream(light), crs=crs), placement)
    if faces is not None and tolerance is None and len(light.faces) > faces:
        log.warning("warning: %d faces are left: fewer would break the mesh", len(light.faces))
    log.info("%s: %d of %d faces", output, len(light.faces), len(whole.faces))
