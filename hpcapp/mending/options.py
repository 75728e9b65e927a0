"""Options of a mesh that several verbs have; imported for every ``--help``."""

from __future__ import annotations

import click

PIECES = click.option(
    "--pieces",
    type=click.IntRange(1),
    metavar="N",
    help="Keep only the N connected pieces of the mesh that are largest by area.",
)
SMALLEST = click.option(
    "--smallest",
    type=click.FloatRange(0, min_open=True),
    metavar="AREA",
    help="Drop the pieces of the mesh with a smaller area, in squared units of the input.",
)
