"""The verb ``heights``; imported for every ``--help``: nothing heavy is imported."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import click

from hpcapp.named_files import SCAN_OR_WORD
from hpccomponent.cli.named_files import OutputFile
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import UsageError

log = logging.getLogger("hpcapp")


@click.command(
    cls=Verb,
    examples=[
        (
            "hpcapp heights ground.laz -o dtm.tif",
            "Write the heights of points in cells as wide as they are apart.",
        ),
        (
            "hpcapp heights ground.ply -o dtm.tif --step 0.5",
            "Write the heights of a mesh in cells half a metre wide.",
        ),
        (
            "hpcapp heights ground.laz -o dtm.tif --contours lines.geojson --interval 1",
            "Write contours at every metre, too.",
        ),
    ],
)
@click.argument("terrain", type=SCAN_OR_WORD, help="A mesh, or points; z is up.")
@click.option(
    "-o",
    "--output",
    type=OutputFile("GeoTIFF", (".tif", ".tiff")),
    required=True,
    metavar="TIF",
    help="GeoTIFF to write.",
)
@click.option(
    "--step",
    type=click.FloatRange(0, min_open=True),
    metavar="LENGTH",
    help="Width of a cell.  [default: as the points are apart, rounded]",
)
@click.option(
    "--contours",
    type=OutputFile("GeoJSON", (".geojson", ".json")),
    metavar="GEOJSON",
    help="Write contours, too.",
)
@click.option(
    "--interval",
    type=click.FloatRange(0, min_open=True),
    metavar="HEIGHT",
    help="Between two contours.",
)
def heights(
    terrain: str,
    output: Path,
    step: float | None,
    contours: Path | None,
    interval: float | None,
) -> None:
    """Write the heights of a terrain as a GeoTIFF, and contours."""
    if (contours is None) != (interval is None):
        raise UsageError("--contours and --interval belong together", "give both, or none")
    import numpy as np

    from hpcapp.applications.heights.geotiff import load_rasterio
    from hpcapp.applications.heights.grid import grid_heights
    from hpcapp.progress import Progress, StageClock
    from hpcapp.progress_display import open_progress
    from hpcapp.terrain.epoch import open_epoch
    from hpcapp.wording import say_number, say_share

    load_rasterio(output)
    with open_progress(sys.stderr) as display:
        clock = StageClock(Progress(display))
        with clock.stage("read"):
            ground = open_epoch(terrain)
        with clock.stage("measure"):
            grid = grid_heights(ground, step)
        with clock.stage("write"):
            count = grid.save(output, contours=contours, interval=interval)
    if contours is not None:
        log.info("%s: %d contours", contours, count)
    known = grid.values[np.isfinite(grid.values)]
    rows, columns = grid.values.shape
    unit = grid.crs.height_unit or grid.crs.unit or ""
    log.info(
        "%s: %d by %d cells %s wide, %s of them with a height, from %s to %s",
        output, columns, rows, say_number(grid.step, grid.crs.unit or ""),
        say_share(known.size / grid.values.size),
        say_number(known.min(), unit), say_number(known.max(), unit),
    )  # fmt: skip
    if grid.uncertainty:
        log.info(
            "95 %% of the heights are off by %s at most, as the points tell",
            say_number(grid.uncertainty, unit),
        )
