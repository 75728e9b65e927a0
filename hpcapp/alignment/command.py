"""The verb ``align``: scans in frames of their own become one cloud.

This module is imported for every ``--help``: numpy and all that stands on it are imported inside.
"""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hpcapp.named_files import POINTS
from hpcapp.parts.options import INPUTS
from hpccomponent.cli.named_files import InputFile, OutputFile, json_option
from hpccomponent.cli.terminal import echo_json
from hpccomponent.cli.verb import Verb

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hpcapp.io import PointSource

log = logging.getLogger("hpcapp")


@click.command(
    cls=Verb,
    examples=[
        (
            "hpcapp align room_1.e57 room_2.e57 room_3.e57 -o rooms.laz",
            "Bring scans in frames of their own into that of the first, as one cloud.",
        ),
        (
            "hpcapp align 'sides/*.ply' -o figure.ply --write-poses poses.json",
            "The same of the sides of a figure; keep the poses, too.",
        ),
        (
            "hpcapp align north.laz south.laz -o all.laz --max-shift 0.5",
            "Correct scans that are registered up to half a metre.",
        ),
    ],
)
@INPUTS
@click.option(
    "-o",
    "--output",
    required=True,
    type=POINTS,
    metavar="POINTS",
    help="Point cloud to write: .ply, .las, .laz, .e57, .xyz, .npz and others.",
)
@click.option(
    "--max-shift",
    type=click.FloatRange(0, min_open=True),
    metavar="LENGTH",
    help="The scans are registered up to this length, in their units.  [default: they lie anyhow]",
)
@click.option(
    "--poses",
    type=InputFile(),
    metavar="FILE",
    help="Search nothing: take the poses that --write-poses has written.",
)
@click.option(
    "--write-poses",
    type=OutputFile("poses", (".json",)),
    metavar="FILE",
    help="Write poses and pairs as .json, too.",
)
@json_option()
def align(
    points: tuple[str, ...],
    output: str,
    max_shift: float | None,
    poses: Path | None,
    write_poses: Path | None,
    as_json: bool,
) -> None:
    """Bring scans in frames of their own into one, as one cloud.

    Each pair says its overlap and its residual. Scans that two poses explain as well are refused.
    """
    from hpcapp.alignment.poses_file import describe_alignment
    from hpcapp.alignment.sources import align_sources
    from hpcapp.applications.points.command import write_source
    from hpcapp.io import open_points
    from hpcapp.io.output import open_output
    from hpcapp.io.points.inputs import gather_points
    from hpcapp.io.staging import replacing

    report: dict[str, Any] = {}

    def place(sources: Sequence[PointSource], names: Sequence[str]) -> Sequence[PointSource]:
        moved, alignment = align_sources(sources, names, max_shift, poses)
        report.update(describe_alignment(alignment, names))
        return moved

    with open_output(output, "points") as target, gather_points(points, place=place) as path:
        written = write_source(target, open_points(path))
        log.info("%s: %d points of %d scans", output, written, len(report["poses"]))
    if write_poses is not None:
        with replacing(write_poses) as file:
            file.write(json.dumps(report, indent=1).encode())
    if as_json:
        echo_json(report)
