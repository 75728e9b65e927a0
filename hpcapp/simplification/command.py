"""The verb ``simplify``; imported for every ``--help``: nothing heavy is imported."""

from __future__ import annotations

import logging
from pathlib import Path

import click

from hpccomponent.errors import UsageError

__all__ = ["simplify"]

log = logging.getLogger("hpcapp")


@click.command()
@click.argument("mesh", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="MESH",
    help="Mesh to write: .ply, .obj, .glb, .vtp, .3mf, .off, .stl, .tiles or .3dtiles; - writes a "
    "PLY to standard output.",
)
@click.option("--faces", type=click.IntRange(4), metavar="N", help="Simplify it to N triangles.")
@click.option(
    "--tolerance",
    type=click.FloatRange(0, min_open=True),
    metavar="LENGTH",
    help="Simplify it while its surface moves by less, in its own units.",
)
def simplify(mesh: Path, output: str, faces: int | None, tolerance: float | None) -> None:
    """Simplify the mesh of a .ply, .obj, .off or .stl, with all that its vertices carry."""
    from hpcapp.io import read_mesh, write_mesh
    from hpcapp.io.output import open_output
    from hpcapp.simplification.mesh import Target, simplify_mesh

    target = Target(faces, tolerance)
    if not target.is_something:
        raise UsageError("nothing to simplify to", "give --faces, --tolerance or both")
    target.check()
    with open_output(output, [mesh]) as path:
        whole = read_mesh(mesh)
        light = simplify_mesh(whole, target)
        write_mesh(path, light)
    if tolerance is None and len(light.faces) > (faces or 0):
        log.warning("warning: %d faces are left: fewer would break the mesh", len(light.faces))
    log.info("%s: %d of %d faces", output, len(light.faces), len(whole.faces))
