"""The verb ``section``; imported for every ``--help``: nothing heavy is imported."""

from __future__ import annotations

import logging
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hpcapp.named_files import FILE_OR_WORD, SCAN
from hpcapp.parts.options import PLACE, cropped
from hpccomponent.cli.named_files import OutputFile, json_option
from hpccomponent.cli.terminal import align_rows, echo, echo_json
from hpccomponent.cli.verb import Verb

if TYPE_CHECKING:
    from hpcapp.geometry.mesh import Mesh
    from hpcapp.io.crs import Crs
    from hpcapp.parts.crop import Crop
    from hpcapp.progress import Progress

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
@cropped(*PLACE)
@click.option("--flat", is_flag=True, help="Lay the sections of a .dxf side by side, as an .svg.")
@json_option()
def section(
    surface: Path,
    output: Path,
    plane: tuple[str, ...],
    along: str | None,
    step: float | None,
    width: float | None,
    flat: bool,
    as_json: bool,
    crop: Crop,
) -> None:
    """Cut a surface by planes, and draw the outlines.

    They are closed where the mesh is, and end where it ends.
    """
    from hpcapp.applications.section.cut import make_sections
    from hpcapp.applications.section.drawings import load_ezdxf
    from hpcapp.applications.section.planes import check_cuts
    from hpcapp.applications.section.sections import check_drawing
    from hpcapp.io.outlines import read_lines
    from hpcapp.progress import Progress, StageClock
    from hpcapp.progress_display import open_progress

    check_cuts(plane, along, step, width)
    check_drawing(output, flat)
    if output.suffix.lower() == ".dxf":
        load_ezdxf(output)
    lines = None if along is None else read_lines(along)
    with open_progress(sys.stderr) as display:
        progress = Progress(display)
        mesh, crs = _open_surface(surface, crop, progress)
        clock = StageClock(progress)
        with clock.stage("cut"):
            sections = make_sections(mesh, crs, plane, lines, step, width, str(surface))
        with clock.stage("write"):
            sections.save(output, flat=flat)
    if as_json:
        echo_json(sections.to_json())
        return
    for line in align_rows(sections.list_rows(), numbers=True):
        echo(line)
    log.info("%s: %s", output, sections.describe())


def _open_surface(path: Path, crop: Crop, progress: Progress) -> tuple[Mesh, Crs]:
    """Read a mesh, or mesh points, and cut out the part that is asked for."""
    from hpcapp.io import find_mesh_crs, holds_faces, open_points, read_mesh
    from hpcapp.io.usable_mesh import check_usable
    from hpcapp.progress import StageClock

    if not holds_faces(path):
        return _mesh_points(path, crop, progress), open_points(path).frame
    with StageClock(progress).stage("read"):
        mesh, crs = read_mesh(path), find_mesh_crs(path)
        check_usable(mesh, path)
        return crop.cut(mesh, crs.height_scale, str(path)), crs


def _mesh_points(path: Path, crop: Crop, progress: Progress) -> Mesh:
    """Mesh the points of a file as ``hpcapp reconstruct`` does by default."""
    from hpcapp.applications.surface.cli.run import run_job
    from hpcapp.applications.surface.job.settings import JobSettings
    from hpcapp.applications.surface.job.source import MARGIN
    from hpcapp.io import read_mesh
    from hpcapp.io.points.inputs import gather_points
    from hpccomponent.files.held_folders import temporary_folder

    log.info("%s: points, which are meshed first, as by hpcapp reconstruct", path)
    choose = partial(crop.narrow, margin=MARGIN)
    with (
        temporary_folder() as folder,
        gather_points([str(path)], None, for_surface=True, choose=choose) as points,
    ):
        output = folder / "mesh.ply"
        settings = JobSettings(points=points, output=str(output), inputs=(path,), crop=crop)
        report = run_job(settings, progress)
        log.info("the mesh: %s", report["summary"])
        return read_mesh(output)
