"""The verb ``convert``: points from any format into another one."""

from __future__ import annotations

import logging
from pathlib import Path

import click

from hpcapp.applications.surface.command import INPUTS, SAMPLE
from hpcapp.applications.surface.output import open_output

__all__ = ["convert"]

log = logging.getLogger("hpcapp")


@click.command()
@INPUTS
@SAMPLE
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="POINTS",
    help="Point cloud to write: .ply, .las, .laz, .e57, .xyz, .npz and others.",
)
def convert(points: tuple[str, ...], sample: int | None, output: str) -> None:
    """Convert the point clouds POINTS into one file of another format.

    Coordinates, normals, colours and other columns are kept where the output can hold them.
    """
    from hpcapp.io import open_points, read_whole, write_points
    from hpcapp.io.ply.joined import write_joined
    from hpcapp.io.points.inputs import STANDARD_INPUT, find_files, gather_points

    files = [Path(name) for name in find_files(points) if name != STANDARD_INPUT]
    with (
        open_output(output, files, "points") as target,
        gather_points(points, sample) as path,
    ):
        source = open_points(path)
        if target.suffix.lower() == ".ply":
            written = write_joined(target, [source])
        else:
            cloud = read_whole(source)
            write_points(target, cloud)
            written = len(cloud)
        for warning in source.findings.warnings:
            log.warning("warning: %s: %s", files[0] if files else "standard input", warning)
        log.info("%s: %d points", output, written)
