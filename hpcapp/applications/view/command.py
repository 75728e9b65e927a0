"""The verb ``view``: a mesh or points on a page, or in a picture.

This module is imported for every ``--help``: numpy and all that stands on it are imported inside.
"""

from __future__ import annotations

import logging
from pathlib import Path

import click

from hpcapp.geometry.axis_names import AXES
from hpcapp.named_files import PAGE, PICTURE, SCAN
from hpcapp.parts.crop import Crop
from hpcapp.parts.options import PLACE, cropped
from hpccomponent.cli.named_files import InputFile
from hpccomponent.cli.terminal import echo_output
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import UsageError

log = logging.getLogger("hpcapp")


def _parse_eye(
    ctx: click.Context, param: click.Parameter, text: str | None
) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        azimuth, elevation = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not two angles, as 30,20", ctx, param) from None
    return azimuth, elevation


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp view mesh.ply", "Open a page on which the mesh can be turned."),
        (
            "hpcapp view mesh.ply --points scan.laz -o page.html --no-open",
            "Write a page that shows how far the mesh is from its points.",
        ),
        (
            "hpcapp view mesh.ply --png mesh.png --eye 60,15 --size 1200",
            "Draw a picture, seen from there.",
        ),
    ],
)
@click.argument(
    "file",
    type=SCAN,
    help="A mesh (.ply, .obj, .stl, .off, .glb, .vtp), or points of any format that is read.",
)
@click.option(
    "--points",
    type=SCAN,
    metavar="POINTS",
    help="Show these points beside the mesh, and how far it is from them.",
)
@click.option(
    "--report",
    type=InputFile(),
    metavar="JSON",
    help="Say what the job decided: the object that 'reconstruct --json' has printed.",
)
@click.option(
    "-o",
    "--output",
    type=PAGE,
    metavar="PAGE",
    help="Page to write, .html.  [default: one in the temporary folder]",
)
@click.option("--png", type=PICTURE, metavar="FILE", help="Draw it into a picture.")
@click.option(
    "--eye",
    callback=_parse_eye,
    metavar="A,E",
    help="From where --png looks: azimuth and elevation in degrees.  [default: 30,20; points: "
    "-122,25]",
)
@click.option("--size", type=click.IntRange(16, 8192), default=800, show_default=True, metavar="N",
              help="Pixels along a side of the picture, of points the longer one.")  # fmt: skip
@cropped(*PLACE)
@click.option(
    "--up",
    type=click.Choice(AXES),
    help="The axis that points up.  [default: as a .glb says; else z, or y of what stands on a "
    "flat base there]",
)
@click.option("--open/--no-open", "is_opened", default=True, show_default=True,
              help="Open the page in a browser; its path is printed in any case.")  # fmt: skip
def view(
    file: Path,
    points: Path | None,
    report: Path | None,
    output: Path | None,
    png: Path | None,
    eye: tuple[float, float] | None,
    size: int,
    crop: Crop,
    up: str | None,
    is_opened: bool,
) -> None:
    """Look at a mesh or at points on a page that works offline.

    With --png and without -o only the picture is made.
    """
    if png is None and eye is not None:
        raise UsageError("--eye means nothing without --png", "the page can be turned by hand")
    for flag, beside in (("--points", points), ("--report", report)):
        if beside is not None and png is not None and output is None:
            raise UsageError(f"{flag} means nothing to a picture", "give -o for a page, too")
    from hpcapp.applications.view.page import find_shown_unit, find_shown_up, make_page, read_shown
    from hpcapp.pages.browser import show_page
    from hpcapp.pages.page import write_page
    from hpcapp.pages.picture import write_picture

    shown = read_shown(file, crop)
    up = up or find_shown_up(file, shown)
    if png is not None:
        write_picture(png, shown, eye, size, up, find_shown_unit(file, shown))
        log.info("%s: a picture of %s", png, file)
        if output is None:
            return
    page = make_page(file, shown, points, report, up, crop)
    path = _temporary_page(file) if output is None else output
    write_page(path, page)
    echo_output(str(path))
    show_page(path, is_opened=is_opened)


def _temporary_page(file: Path) -> Path:
    """Return a page that stays when this process has gone: a browser reads it later."""
    import tempfile

    return Path(tempfile.mkdtemp(prefix="hpcapp-view-")) / f"{file.stem}.html"
