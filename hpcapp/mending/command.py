"""The verb ``mend``; imported for every ``--help``: nothing heavy is imported."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hpcapp.mending.options import PIECES, SMALLEST
from hpcapp.parts.crop import Crop
from hpcapp.parts.options import PLACE, cropped
from hpcapp.printing.request import GROUP, NAMES, add_print_options, take_printing
from hpcapp.simplification.command import MESH, Output, with_output
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import UsageError

if TYPE_CHECKING:
    from hpcapp.geometry.mesh import Mesh
    from hpcapp.io.crs import Crs

log = logging.getLogger("hpcapp")

GROUPS = {
    "In this order": (
        "fill_holes", "box", "around", "polygon", "pieces", "smallest", "up", "faces", "tolerance",
        "size", "attributes", "texture", "images", "viewpoint",
    ),
    GROUP: NAMES,
    "Output": ("output", "origin"),
}  # fmt: skip


@add_print_options
@click.command(
    cls=Verb,
    groups=GROUPS,
    examples=[
        (
            "hpcapp mend mesh.ply -o whole.ply --fill-holes 0.05",
            "Fill the holes that fit into a box with a diagonal of 0.05.",
        ),
        (
            "hpcapp mend site.ply -o hall.glb --box 0,0,0,20,30,9 --up z",
            "Cut a hall out of a site, and let it stand in viewers.",
        ),
        (
            "hpcapp mend lion.ply -o lion.3mf --print --unit m --scale 1:50",
            "Make a print of a lion that was scanned in metres.",
        ),
    ],
)
@MESH
@click.option(
    "--fill-holes",
    metavar="LENGTH",
    help="Fill holes up to this size, the diagonal of the box around a border: in its own units, "
    "or in median edges as 10s.",
)
@PIECES
@SMALLEST
@cropped(*PLACE)
@with_output
def mend(
    mesh: Path,
    fill_holes: str | None,
    pieces: int | None,
    smallest: float | None,
    crop: Crop,
    **options: Any,
) -> None:
    """Fill holes, cut, drop pieces, turn, simplify or print a mesh.

    In this order. What its vertices carry stays.
    """
    from hpcapp.applications.surface.boundary.lengths import require_length
    from hpcapp.applications.surface.steps.summary import summarize
    from hpcapp.applications.surface.stitching.topology import check_mesh
    from hpcapp.geometry.pieces import PieceChoice
    from hpcapp.mending.mend import Mending, mend_mesh
    from hpcapp.progress import Progress, StageClock
    from hpcapp.progress_display import open_progress

    printing = take_printing(options)
    output = Output(**options)
    largest = None if fill_holes is None else require_length("fill_holes", fill_holes)
    asked = Mending(largest, PieceChoice(pieces, smallest), crop)
    is_written_anew = output.is_light or output.is_placed or output.is_bare
    if not (asked.is_something or is_written_anew or printing):
        advice = "give --fill-holes, --pieces, --box, --up, --faces or --print"
        raise UsageError("nothing to mend", advice)

    def change(whole: Mesh, crs: Crs) -> Mesh:
        with open_progress(sys.stderr) as display:
            clock = StageClock(Progress(display))
            return mend_mesh(whole, asked, crs.height_scale, str(mesh), clock)

    if printing is not None:
        from hpcapp.printing.prepare import PRINTED, make_print

        def finish(light: Mesh, crs: Crs, up: str | None) -> tuple[Mesh, Crs]:
            made, facts = make_print(light, crs, printing, up, pieces or 1)
            log.info("%s: %s", output.output, facts.describe())
            return made, PRINTED

        output.write(mesh, change, finish)
        return
    light = output.write(mesh, change)[1]
    log.info("%s: %s", output.output, summarize(check_mesh(light), {}))
