"""The options that say which points or faces are asked for; verbs share them.

This module is imported for every ``--help``: nothing heavy is imported.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeAlias

import click

from hpcapp.named_files import FILE_OR_WORD, SCANS
from hpcapp.parts.crop import CROPPED, parse_crop

Verb: TypeAlias = Callable[..., None]

INPUTS = click.argument(
    "points",
    nargs=-1,
    required=True,
    type=SCANS,
    help="Files of any format that is read (.ply, .las, .laz, .e57, .xyz and others), or patterns "
    "as 'scans/*.laz', in quotes; several are one cloud. - is the standard input.",
)
SAMPLE = click.option(
    "--sample",
    type=click.IntRange(10),
    metavar="N",
    help="POINTS is a mesh: take N points on its faces in place of its vertices. A surface is made "
    "so of 100,000 where the vertices are too few for the faces.",
)
BOX = click.option(
    "--box",
    metavar="X0,Y0,Z0,X1,Y1,Z1",
    help="Only what lies between two corners, in the coordinates of the input.",
)
AROUND = click.option(
    "--around",
    metavar="X,Y,Z,R",
    help="Only what lies within a distance R of a place.",
)
POLYGON = click.option(
    "--polygon",
    type=FILE_OR_WORD,
    metavar="FILE",
    help="Only what lies above and below polygons: .geojson, .wkt or .shp, or WKT itself.",
)
CLASSES = click.option(
    "--classes",
    metavar="N,N",
    help="Only points of these classes, as 2,6: ground and buildings of LAS.",
)
NOT_CLASSES = click.option(
    "--not-classes",
    metavar="N,N",
    help="No points of these classes. Noise of LAS, 7 and 18, is left out in any case, unless "
    "--classes names it.",
)
GROUND = click.option(
    "--ground",
    is_flag=True,
    help="Only the bare ground: class 2 of the file, or what a cloth simulation finds.",
)
PLACE = (BOX, AROUND, POLYGON)
POINTS = (*PLACE, CLASSES, NOT_CLASSES, GROUND)


def cropped(*options: Callable[[Verb], Verb]) -> Callable[[Verb], Verb]:
    """Give a verb some of these options, and what they ask for as its `crop`."""

    def decorate(verb: Verb) -> Verb:
        @wraps(verb)
        def run(*args: Any, **given: Any) -> None:
            asked = {name: given.pop(name) for name in CROPPED if name in given}
            verb(*args, crop=parse_crop(**asked), **given)

        command: Verb = run
        for option in reversed(options):
            command = option(command)
        return command

    return decorate
