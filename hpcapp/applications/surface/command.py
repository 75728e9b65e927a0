"""The verbs of surface reconstruction: ``reconstruct``, ``simulate`` and ``info``.

This module is imported for every ``--help``: numpy and all that stands on it are imported inside.
"""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hpccomponent.errors import UsageError

if TYPE_CHECKING:
    from hpcapp.applications.surface.settings import Settings

__all__ = ["check_flags", "info", "reconstruct", "simulate"]

log = logging.getLogger("hpcapp")

POINTS = click.Path(dir_okay=False, path_type=Path)


def _only_for(ctx: click.Context, method: str, names: tuple[str, ...]) -> None:
    """Raise UsageError where an option of another method was typed."""
    for name in names:
        if ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            flag = "--" + name.replace("_", "-")
            raise UsageError(
                f"{flag} means nothing to --method {ctx.params['method']}",
                f"leave it out, or choose --method {method}",
            )


def _only_without_patches(ctx: click.Context) -> None:
    """Raise UsageError where a rule was typed that --patches takes the place of."""
    for name in ("delta", "cone", "max_points"):
        if ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            flag = "--" + name.replace("_", "-")
            raise UsageError(
                f"--patches takes the place of {flag}, so they exclude each other",
                "give one of them",
            )


def _only_without_cluster(ctx: click.Context) -> None:
    """Raise UsageError where workers were asked for beside those of the cluster."""
    if ctx.get_parameter_source("workers") is click.core.ParameterSource.COMMANDLINE:
        raise UsageError(
            "--cluster and --workers exclude each other",
            "the workers of a cluster are those of its file",
        )
    backend = ctx.params["backend"]
    if backend not in ("auto", "zmq"):
        raise UsageError(
            f"--cluster and --backend {backend} exclude each other",
            "--backend zmq uses the cluster's workers, auto where they pay",
        )


PAPER_OPTIONS = ("delta", "max_points", "cone", "patches", "norm")
HIERARCHICAL_OPTIONS = ("clean", "smoothness", "detail", "max_memory", "temp_dir", "resume")


def check_flags(ctx: click.Context) -> None:
    """Raise UsageError where flags contradict each other.

    Parameters
    ----------
    ctx : click.Context
        Of `reconstruct`.
    """
    chosen = [name for name in ("grid", "depth", "voxel_size") if ctx.params[name] is not None]
    if len(chosen) > 1:
        flags = " and ".join("--" + name.replace("_", "-") for name in chosen)
        raise UsageError(f"{flags} exclude each other", "give one of them")
    if ctx.params["patches"] is not None:
        _only_without_patches(ctx)
    if sys.stdout is None and (ctx.params["output"] == "-" or ctx.params["as_json"]):
        raise UsageError("the standard output is closed", "give -o a file and leave --json out")
    if ctx.params["output"] == "-" and ctx.params["as_json"]:
        raise UsageError("-o - and --json both want the standard output", "give one of them")
    if ctx.params["cluster"] is not None:
        _only_without_cluster(ctx)
    if ctx.params["backend"] != "auto":
        from hpcapp.backends.selection import check_backend

        check_backend(ctx.params["backend"])
    if ctx.params["method"] == "paper":
        _only_for(ctx, "hierarchical", HIERARCHICAL_OPTIONS)
    else:
        _only_for(ctx, "paper", PAPER_OPTIONS)


@click.command()
@click.argument("points", type=POINTS)
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="MESH",
    help="Mesh to write: .ply, .obj, .off, .stl, or a folder of PLYs, .tiles; - writes a PLY to "
    "standard output.",
)
@click.option(
    "--method",
    type=click.Choice(["hierarchical", "paper"]),
    default="hierarchical",
    show_default=True,
    help="Hermite quadrics on a pyramid, or the paper's algorithm.",
)
@click.option(
    "--grid",
    type=click.IntRange(16, 4096),
    metavar="N",
    help="Cells along the longest side.  [default: 256]",
)
@click.option("--depth", type=click.IntRange(4, 12), metavar="D", help="The same as --grid 2^D.")
@click.option(
    "--voxel-size",
    type=click.FloatRange(0, min_open=True),
    metavar="S",
    help="Edge of a cell, in the units of the input.",
)
@click.option(
    "--backend",
    default="auto",
    metavar="NAME",
    show_default=True,
    help="Where batches run: auto (where it should be fastest), serial, threads, processes, zmq, "
    "dask=ADDRESS, ray[=ADDRESS], mpi, or MODULE:FUNCTION that makes an Executor.",
)
@click.option(
    "--workers",
    type=click.IntRange(1, 1024),
    metavar="W",
    help="How many workers; with --backend auto at most so many, as many as pay.",
)
@click.option(
    "--policy",
    type=click.Choice(["adaptive", "pull", "equal"]),
    default="adaptive",
    show_default=True,
    help="Batches by each worker's speed, to whoever is free, or the paper's equal batches.",
)
@click.option(
    "--cluster",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Run on a cluster: by its cluster file (.yaml), or on its head by its inventory (.json).",
)
@click.option(
    "--max-memory",
    metavar="SIZE",
    help="Most memory of this process and of each worker, as 2G; larger clouds stay on disk.",
)
@click.option(
    "--temp-dir",
    metavar="PLACE",
    help="Where points and finished tiles lie meanwhile: a folder, or s3://BUCKET/PREFIX.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Go on from what a job that was killed has left in --temp-dir, and leave there what is "
    "finished if this one fails.",
)
@click.option(
    "--smoothness",
    type=click.FloatRange(0.1, 10),
    default=1.0,
    show_default=True,
    help="Factor on the smoothing that the noise asks for.",
)
@click.option(
    "--detail",
    type=click.FloatRange(0.1, 10),
    default=1.0,
    show_default=True,
    help="Factor on the finest detail that the spacing allows.",
)
@click.option(
    "--clean/--no-clean",
    default=True,
    show_default=True,
    help="hierarchical: drop outliers and turn wrong normals round first.",
)
@click.option(
    "--delta",
    type=click.FloatRange(-1, 1),
    default=0.1,
    show_default=True,
    help="paper: the normal cone's condition.",
)
@click.option(
    "--max-points",
    type=click.IntRange(1),
    metavar="N",
    help="paper: most points of a patch.  [default: no limit]",
)
@click.option(
    "--cone",
    type=click.Choice(["paper", "complement"]),
    default="paper",
    show_default=True,
    help="paper: n.m > delta as printed, or n.m > 1 - delta.",
)
@click.option(
    "--patches",
    type=click.IntRange(1),
    metavar="N",
    help="paper: split the fullest box until there are N patches, in place of the cone.",
)
@click.option(
    "--norm",
    type=click.Choice(["consistent", "printed"]),
    default="consistent",
    show_default=True,
    help="paper: columns of D with the factor sqrt(2), or as printed.",
)
@click.option(
    "--outliers/--no-outliers",
    default=False,
    show_default=True,
    help="Remove statistical outliers first.",
)
@click.option(
    "--denoise/--no-denoise",
    default=False,
    show_default=True,
    help="Project the points by moving least squares first.",
)
@click.option(
    "--resample/--no-resample",
    default=False,
    show_default=True,
    help="Resample the points to even density first.",
)
@click.option(
    "--events",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Write the progress to a file as it comes, one JSON object a line.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on standard output.")
@click.pass_context
def reconstruct(ctx: click.Context, /, **options: Any) -> None:
    """Reconstruct a watertight mesh from the oriented points of the file POINTS."""
    check_flags(ctx)
    as_json = options.pop("as_json")
    events = options.pop("events")
    cluster = options["cluster"]
    if cluster is not None and cluster.suffix != ".json":
        from hpcapp.applications.surface.remote import run_on_cluster

        report = run_on_cluster(ctx)
    else:
        report = _run_here(options, events)
    if as_json:
        click.echo(json.dumps(report))
    else:
        log.info("%s: %s", options["output"], report["summary"])


def _run_here(options: dict[str, Any], events: Path | None) -> dict[str, Any]:
    """Run the job with this process as its master."""
    from hpcapp.backends.selection import start_early

    name = options["backend"] if options["cluster"] is None else "cluster"
    if options["resume"]:  # it may wait for another job, and machines would give up meanwhile
        name = "auto"
    with start_early(name, options["workers"]) as machines:
        from hpcapp.applications.surface.job import run_job  # while the machines start
        from hpcapp.applications.surface.memory import parse_size
        from hpcapp.applications.surface.settings import Settings
        from hpcapp.progress_display import open_events, open_progress

        if options["max_memory"] is not None:
            options["max_memory"] = parse_size(options["max_memory"])
        settings: Settings = Settings(**options)
        with open_progress(sys.stderr) as display, open_events(events, display) as progress:
            return run_job(settings, progress, machines)


@click.command()
@click.argument("points", type=POINTS)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on standard output.")
def info(points: Path, as_json: bool) -> None:
    """Print what the point cloud POINTS holds: count, bounds, normals, spacing, NaN points."""
    from hpcapp.applications.surface.info import describe
    from hpcapp.io import read_points

    facts = describe(read_points(points))
    if as_json:
        click.echo(json.dumps(facts))
        return
    width = max(map(len, facts))
    for name, value in facts.items():
        click.echo(f"{name.replace('_', ' '):<{width}}  {_readable(value)}")


def _readable(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return "  ".join(_readable(item) for item in value)
    if isinstance(value, dict):
        return ", ".join(f"{name} {_readable(item)}" for name, item in value.items())
    return str(value)


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
