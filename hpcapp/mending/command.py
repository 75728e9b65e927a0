"""The verb ``mend``; imported for every ``--help``: nothing heavy is imported."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hpcapp.mending.options import PIECES, SMALLEST
from hpcapp.simplification.command import MESH, Output, with_output
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import UsageError

if TYPE_CHECKING:
    from hpcapp.geometry.mesh import Mesh

log = logging.getLogger("hpcapp")

GROUPS = {
    "First": ("fill_holes",),
    "Then": ("pieces", "smallest"),
    "Last": ("up", "origin", "faces", "tolerance", "size", "output"),
}


@click.command(
    cls=Verb,
    groups=GROUPS,
    examples=[
        (
            "hpcapp mend mesh.ply -o whole.ply --fill-holes 0.05",
            "Fill the holes that fit into a box with a diagonal of 0.05.",
        ),
        (
            "hpcapp mend lion.ply -o lion.glb --pieces 1 --faces 50000",
            "Keep the largest piece, and 50,000 triangles of it.",
        ),
    ],
)
@MESH
@click.option(
    "--fill-holes",
    type=click.FloatRange(0, min_open=True),
    metavar="LENGTH",
    help="Fill holes up to this size, the diagonal of the box around a border, in its own units.",
)
@PIECES
@SMALLEST
@with_output
def mend(
    mesh: Path,
    fill_holes: float | None,
    pieces: int | None,
    smallest: float | None,
    **options: Any,
) -> None:
    """Mend a mesh: fill holes, drop pieces, turn and simplify it, in this order.

    What its vertices carry stays.
    """
    from hpcapp.applications.surface.job.summary import summarize
    from hpcapp.applications.surface.stitching.topology import check_mesh
    from hpcapp.geometry.pieces import PieceChoice
    from hpcapp.mending.mend import mend_mesh

    output, choice = Output(**options), PieceChoice(pieces, smallest)
    if fill_holes is None and not choice.is_something and not output.is_light:
        raise UsageError(
            "nothing to mend", "give --fill-holes, --pieces, --smallest, --faces or --size"
        )

    def change(whole: Mesh) -> Mesh:
        return mend_mesh(whole, fill_holes, choice)

    light = output.write(mesh, change)[1]
    log.info("%s: %s", output.output, summarize(check_mesh(light), {}))
