"""The verb ``section``; imported for every ``--help``: nothing heavy is imported."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import click

from hpcapp.named_files import FILE_OR_WORD, SCAN
from hpcapp.parts.crop import parse_crop
from hpcapp.parts.options import AROUND, BOX, POLYGON
from hpccomponent.cli.named_files import OutputFile, json_option
from hpccomponent.cli.terminal import echo, echo_json
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import UsageError

log = logging.getLogger("hpcapp")

GROUPS = {
    "Where to cut": ("plane", "along", "step", "width", "box", "around", "polygon"),
    "Output": ("output", "flat", "as_json"),
}


@click.command(
    cls=Verb,
    groups=GROUPS,
    examples=[
        (
            "hpcapp section pipes.ply -o pipes.svg --plane x=3.2 --plane z --step 3",
            "Draw a section and a plan at each multiple of 3, to scale.",
        ),
        (
            "hpcapp section road.laz -o cross.dxf --along axis.geojson --step 5 --width 20",
            "Mesh a road, and cut it across its axis every 5 metres.",
        ),
        (
            "hpcapp section road.ply -o profile.svg --along axis.geojson",
            "Draw the profile along it.",
        ),
    ],
)
@click.argument(
    "surface",
    type=SCAN,
    help="A mesh; or points, which are meshed first, as 'hpcapp reconstruct' does by default.",
)
@click.option(
    "-o",
    "--output",
    type=OutputFile("drawing", (".dxf", ".svg", ".geojson", ".json")),
    required=True,
    metavar="FILE",
    help="Drawing to write: .dxf or .geojson in the coordinates of the input, .svg flat and to "
    "scale.",
)
@click.option(
    "--plane",
    multiple=True,
    metavar="PLANE",
    help="Cut here: z=10, or z with --step, or X,Y,Z,DX,DY,DZ, a place and the direction square to "
    "the plane; may be given several times.",
)
@click.option(
    "--along",
    type=FILE_OR_WORD,
    metavar="LINE",
    help="Cut square to a line on the map, with --step, or along it: .geojson, .wkt or .shp, or "
    "WKT itself.",
)
@click.option(
    "--step",
    type=click.FloatRange(0, min_open=True),
    metavar="LENGTH",
    help="Between two sections.",
)
@click.option(
    "--width",
    type=click.FloatRange(0, min_open=True),
    metavar="LENGTH",
    help="Of each section across a line, half of it to either side.  [default: all that is there]",
)
@BOX
@AROUND
@POLYGON
@click.option("--flat", is_flag=True, help="Lay the sections of a .dxf side by side, as an .svg.")
@json_option()
def section(
    surface: Path,
    output: Path,
    plane: tuple[str, ...],
    along: str | None,
    step: float | None,
    width: float | None,
    box: str | None,
    around: str | None,
    polygon: str | None,
    flat: bool,
    as_json: bool,
) -> None:
    """Cut a surface by planes, and draw the outlines.

    They are closed where the mesh is, and end where it ends.
    """
    if bool(plane) == (along is not None):
        raise UsageError(
            "nothing says where to cut"
            if along is None
            else "--plane and --along exclude each other",
            "give --plane z=10, or --along LINE.geojson --step 5",
        )
    if width is not None and (along is None or step is None):
        raise UsageError("--width is for sections across a line", "give --along and --step, too")
    from hpcapp.applications.section.drawings import load_ezdxf
    from hpcapp.applications.section.make import list_rows, list_values, make_sections, open_surface
    from hpcapp.io.outlines import read_lines
    from hpcapp.progress import Progress, StageClock
    from hpcapp.progress_display import open_progress

    if output.suffix.lower() == ".dxf":
        load_ezdxf(output)
    crop = parse_crop(box, around, polygon)
    lines = None if along is None else read_lines(along)
    with open_progress(sys.stderr) as display:
        progress = Progress(display)
        mesh, crs = open_surface(surface, crop, progress)
        clock = StageClock(progress)
        with clock.stage("cut"):
            sections = make_sections(mesh, crs, plane, lines, step, width, str(surface))
        with clock.stage("write"):
            sections.save(output, flat=flat)
    if as_json:
        echo_json({"sections": list_values(sections), "unit": crs.unit})
        return
    rows = list_rows(sections)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for name, *cells in rows:
        columns = (f"{one:>{w}}" for one, w in zip(cells, widths[1:], strict=True))
        echo("  ".join([f"{name:{widths[0]}}", *columns]).rstrip())
    log.info("%s: %s", output, sections.describe())
