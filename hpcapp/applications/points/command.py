"""The verbs of point clouds: ``info`` and ``convert``.

This module is imported for every ``--help``: numpy and all that stands on it are imported inside.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hpcapp.named_files import FILE_OR_WORD, PICTURE
from hpcapp.named_files import POINTS as POINT_FILE
from hpcapp.parts.crop import Crop
from hpcapp.parts.options import INPUTS, POINTS, SAMPLE, cropped
from hpccomponent.cli.named_files import json_option
from hpccomponent.cli.option_names import name_option
from hpccomponent.cli.terminal import echo, echo_json, visible_line
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import UsageError

if TYPE_CHECKING:
    from hpcapp.applications.surface.normals.viewpoint import Viewpoint
    from hpcapp.io import PointSource


log = logging.getLogger("hpcapp")

_LONGEST = 120  # characters of a coordinate system that are shown to people


@click.command(
    cls=Verb,
    examples=[
        (
            "hpcapp info scan.laz",
            "Say how many points there are, where, how dense, and with which columns.",
        ),
        ("hpcapp info 'scans/*.e57' --json", "The same of many scans as one, for a program."),
        (
            "hpcapp info scan.ply --png spacing.png --by-spacing",
            "Draw where the points are dense, and where sparse.",
        ),
    ],
)
@INPUTS
@SAMPLE
@cropped(*POINTS)
@json_option()
@click.option("--png", type=PICTURE, metavar="FILE", help="Draw the points into a picture.")
@click.option(
    "--by-spacing",
    is_flag=True,
    help="In the picture, colour the points by their spacing: dense ones blue, sparse ones yellow.",
)
@click.option(
    "--by-noise",
    is_flag=True,
    help="Likewise by their noise: good ones blue, bad ones yellow.",
)
def info(
    points: tuple[str, ...],
    sample: int | None,
    crop: Crop,
    as_json: bool,
    png: Path | None,
    by_spacing: bool,
    by_noise: bool,
) -> None:
    """Print what point clouds hold, and what was taken for what."""
    from hpcapp.applications.points.info import describe_file
    from hpcapp.applications.points.place_colours import colour_by_noise, colour_by_spacing
    from hpcapp.io import open_points
    from hpcapp.io.points.inputs import gather_points
    from hpcapp.pages.thumbnail import write_thumbnail

    words = ["--by-spacing"] * by_spacing + ["--by-noise"] * by_noise
    if words and png is None:
        raise UsageError(f"{words[0]} is for the picture", "add --png FILE, or leave it out")
    if len(words) > 1:
        raise UsageError("a picture has one colouring", f"leave {' or '.join(words)} out")
    with gather_points(points, sample, keeps_noise=crop.keeps_noise, choose=crop.narrow) as path:
        source = crop.take(open_points(path, keeps_noise=crop.keeps_noise))
        facts, findings, cloud = describe_file(source)
    shown = points[0] if len(points) == 1 else f"{points[0]} and others"
    for line in findings.lines():
        log.warning("warning: %s: %s", shown, line)
    if png is not None:
        scans = source.isotropic().scans
        scanner = scans[0].scanner if len(scans) == 1 else None
        if words:
            cloud = colour_by_spacing(cloud) if by_spacing else colour_by_noise(cloud)
        write_thumbnail(png, cloud, scanner, source.unit)
    if as_json:
        echo_json(facts)
        return
    width = max(map(len, facts))
    for name, value in facts.items():
        echo(f"{name.replace('_', ' '):<{width}}  {visible_line(readable(value))}")


def readable(value: object) -> str:
    """Return a JSON value as people read it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None or (not value and isinstance(value, str | list | dict)):
        return "-"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return "  ".join(readable(item) for item in value)
    if isinstance(value, dict):
        return ", ".join(f"{name} {readable(item)}" for name, item in value.items())
    text = str(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp convert scan.e57 -o scan.laz", "Write an E57 as LAZ, with its colours."),
        ("hpcapp convert 'scans/*.laz' -o all.ply", "Join many files into one."),
        (
            "hpcapp convert scan.ply -o scan.xyz --rejected strays.ply",
            "Write the outliers, strays and wires of a scan into a file of their own.",
        ),
    ],
)
@INPUTS
@SAMPLE
@cropped(*POINTS)
@click.option(
    "-o",
    "--output",
    required=True,
    type=POINT_FILE,
    metavar="POINTS",
    help="Point cloud to write: .ply, .las, .laz, .e57, .xyz, .npz and others.",
)
@click.option(
    "--rejected",
    type=POINT_FILE,
    metavar="FILE",
    help="Write the outliers, strays and wires that a job drops into a cloud of their own, too, "
    "and what a scanner has looked through from elsewhere.",
)
@click.option(
    "--viewpoint",
    type=FILE_OR_WORD,
    multiple=True,
    metavar="WHERE",
    help="With --rejected: where the points were measured from, as of reconstruct: a trajectory "
    "with times tells what moved.",
)
def convert(
    points: tuple[str, ...],
    sample: int | None,
    crop: Crop,
    output: str,
    rejected: str | None,
    viewpoint: tuple[str, ...],
) -> None:
    """Convert point clouds into one file of another format.

    What the output cannot hold is left out, with a warning.
    """
    from hpcapp.applications.surface.normals.viewpoint import parse_viewpoint
    from hpcapp.io import open_points
    from hpcapp.io.output import open_output
    from hpcapp.io.points.inputs import find_paths, gather_points

    if viewpoint and rejected is None:
        raise UsageError(
            f"{name_option('viewpoint')} tells what is rejected", "give --rejected, too"
        )
    where, files = parse_viewpoint(viewpoint), find_paths(points)
    with (
        open_output(output, "points") as target,
        gather_points(points, sample, keeps_noise=crop.keeps_noise, choose=crop.narrow) as path,
    ):
        source = crop.take(open_points(path, keeps_noise=crop.keeps_noise))
        written = write_source(target, source)
        for warning in source.findings.lines():
            log.warning("warning: %s: %s", files[0] if files else "standard input", warning)
        log.info("%s: %d points", output, written)
        if rejected is not None:
            with open_output(rejected, "points") as target:
                _write_rejected(target, source, rejected, where)


def _write_rejected(target: Path, source: PointSource, shown: str, where: Viewpoint) -> None:
    """Write the points of a source that a job drops."""
    import numpy as np

    from hpcapp.applications.points.rejected import take_rejected
    from hpcapp.applications.surface.normals.sensor import find_path
    from hpcapp.applications.surface.reading.seen_through import are_seen_through, look_around
    from hpcapp.io import read_whole, write_points
    from hpcapp.io.batches import join_points
    from hpcapp.io.frame import scale_heights

    source = source.isotropic()
    whole = read_whole(source)
    path = find_path(where) * [1.0, 1.0, source.frame.height_scale, 1.0]
    is_ghost = are_seen_through(whole, look_around(source, path))
    cloud, cleaned = take_rejected(whole.take(np.flatnonzero(~is_ghost)), shown)
    cloud = join_points([cloud, whole.take(np.flatnonzero(is_ghost))])
    cloud = scale_heights(cloud, 1.0 / source.frame.height_scale)
    write_points(target, cloud, source.crs, source.unit, source.scans, source.height_unit)
    log.info(
        "%s: %d outliers, %d strays, %d points along lone lines, %d seen through from elsewhere",
        shown, cleaned.outliers, cleaned.strays, cleaned.lone_lines, int(is_ghost.sum()),
    )  # fmt: skip


def write_source(target: Path, source: PointSource) -> int:
    """Write the points of a source, in memory at once but for a PLY; return how many there are."""
    from hpcapp.io import read_whole, write_points
    from hpcapp.io.ply.joined import write_joined

    if target.suffix.lower() == ".ply":
        return write_joined(target, [source])
    cloud = read_whole(source)
    write_points(target, cloud, source.crs, source.unit, source.scans, source.height_unit)
    return len(cloud)
