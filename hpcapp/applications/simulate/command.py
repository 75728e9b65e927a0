"""The verb of the virtual scanner: ``simulate``.

This module is imported for every ``--help``: numpy and all that stands on it are imported inside.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import click

__all__ = ["simulate"]

log = logging.getLogger("hpcapp")

POINTS = click.Path(dir_okay=False, path_type=Path)


@click.command()
@click.option("--shape", required=True, help="Which model; an unknown name lists all.")
@click.option("-o", "--output", required=True, type=POINTS, help="Point cloud to write.")
@click.option("--points", type=int, default=100_000, show_default=True, help="Exactly so many.")
@click.option(
    "--views",
    type=int,
    default=20,
    show_default=True,
    help="Positions of the scanner; 0 samples the whole surface evenly.",
)
@click.option(
    "--noise",
    type=float,
    default=0.0,
    show_default=True,
    help="Depth noise (standard deviation), as a fraction of the diagonal.",
)
@click.option(
    "--drift",
    type=float,
    default=0.0,
    show_default=True,
    help="Smooth error of each view's depth (standard deviation), as a fraction of the diagonal.",
)
@click.option(
    "--correlation",
    type=float,
    default=0.05,
    show_default=True,
    help="Length over which --drift changes, as a fraction of the diagonal.",
)
@click.option(
    "--dropout",
    type=float,
    default=0.0,
    show_default=True,
    help="Share of each view that is lost, in blotches.",
)
@click.option(
    "--grazing",
    type=float,
    default=80.0,
    show_default=True,
    help="Greatest angle of incidence that still echoes, in degrees.",
)
@click.option(
    "--pose-error",
    type=float,
    default=0.0,
    show_default=True,
    help="Misplacement of each view, as a fraction of the diagonal.",
)
@click.option(
    "--outliers",
    type=float,
    default=0.0,
    show_default=True,
    help="Share of points that are wrong, near and far.",
)
@click.option(
    "--density-ratio",
    type=float,
    default=1.0,
    show_default=True,
    help="Density at the dense end over that at the sparse end.",
)
@click.option(
    "--missing", type=int, default=0, show_default=True, help="Balls from which nothing came back."
)
@click.option(
    "--flipped",
    type=float,
    default=0.0,
    show_default=True,
    help="Share of points whose normal has the wrong sign.",
)
@click.option(
    "--normals",
    type=click.Choice(["pca", "exact"]),
    default="pca",
    show_default=True,
    help="From the neighbours' plane, or the model's own.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="One seed gives one scan.")
def simulate(shape: str, output: Path, **settings: Any) -> None:
    """Scan an analytic model, whose true surface is known, and write the points."""
    from hpcapp.applications.simulate.scanner import ScanSettings, simulate_scan
    from hpcapp.applications.simulate.shapes import find_shape
    from hpcapp.io import check_writable, write_points

    check_writable(output, "points")
    cloud = simulate_scan(find_shape(shape), ScanSettings(**settings))
    write_points(output, cloud)
    log.info("%s: %d points of %s", output, len(cloud), shape)
