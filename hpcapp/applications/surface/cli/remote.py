"""A reconstruction that another machine runs."""

from __future__ import annotations

import shlex
from collections.abc import Collection
from functools import partial
from pathlib import Path
from typing import Any

import click

from hpcapp.applications.points.crop import CROPPED, parse_crop
from hpcapp.applications.surface.job.source import MARGIN
from hpcapp.applications.surface.methods.options import typed_command, typed_options
from hpcapp.applications.surface.normals.viewpoint import parse_viewpoint, type_viewpoint
from hpcapp.backends.cluster import load_cluster_function
from hpcapp.io import FOLDER_SUFFIXES, MESH_SUFFIXES, drop_unusable, read_points
from hpcapp.io.output import open_output
from hpcapp.io.points.inputs import find_paths, gather_points
from hpccomponent.errors import UsageError

DETAILS = ("timeline", "owners")
"""What a report has with --details."""

OF_THIS_MACHINE = ("points", "sample", "output", "cluster", "events", "report", "png", "as_json")
"""What options name here; on the head they are the job's own."""

_FILES = {
    "events": "its jobs keep their events by themselves",
    "trace": "give it to 'hpcapp submit' behind --: it lies in the job's folder then",
}


def check_file(output: str) -> None:
    """Refuse an output that is a folder: one file is fetched from a cluster.

    Parameters
    ----------
    output : str
        What the user typed.

    Raises
    ------
    UsageError
        It is.
    """
    if Path(output).suffix.lower() in FOLDER_SUFFIXES:
        raise UsageError(
            f"{output}: is a folder, and one file comes from a cluster",
            f"write {', '.join(MESH_SUFFIXES)} or .3mf",
        )


def check_points(points: Path, sample: int | None = None) -> None:
    """Read the points as the job will; InputError where it could not use them.

    Parameters
    ----------
    points : Path
        The file.
    sample : int, optional
        It is a mesh: so many points on its faces are taken.

    Raises
    ------
    UsageError
        Its suffix is unknown.
    InputError
        It cannot be read, or its points cannot be used.
    """
    with gather_points([str(points)], sample) as path:
        drop_unusable(read_points(path), str(path))


def type_for_head(ctx: click.Context, without: Collection[str]) -> list[str]:
    """Return the options that were typed, with what is in the files that they name.

    Parameters
    ----------
    ctx : click.Context
        Of `reconstruct`.
    without : collection of str
        Names of parameters that are left out.
    """
    words = typed_options(ctx, (*without, "viewpoint", "polygon"))
    crop = parse_crop(*(ctx.params[name] for name in CROPPED))
    if crop.polygon:
        words += ["--polygon", crop.polygon]
    return words + type_viewpoint(parse_viewpoint(ctx.params["viewpoint"]))


def run_on_cluster(ctx: click.Context) -> dict[str, Any]:
    """Have a cluster's head run the job with the options that were typed, and fetch the mesh.

    Parameters
    ----------
    ctx : click.Context
        Of `reconstruct`.

    Returns
    -------
    dict
        The job's report.

    Raises
    ------
    HpcError
        Whatever went wrong, here or there.
    """
    names, cluster = ctx.params["points"], ctx.params["cluster"]
    for name, instead in _FILES.items():
        if ctx.params[name] is not None:
            raise UsageError(f"--{name} means nothing to a cluster file", instead)
    run = load_cluster_function("run")
    files = find_paths(names)
    crop = parse_crop(*(ctx.params[name] for name in CROPPED))
    check_file(ctx.params["output"])
    _check_shown(ctx)
    with (
        open_output(ctx.params["output"], files) as target,
        gather_points(
            names,
            ctx.params["sample"],
            goes_elsewhere=True,
            keeps_noise=crop.keeps_noise,
            choose=partial(crop.take, margin=MARGIN),
        ) as points,
    ):
        check_points(points)
        words = type_for_head(ctx, OF_THIS_MACHINE)
        is_detailed = ctx.params["details"]
        if ctx.params["report"] is not None and not is_detailed:
            words.append("--details")
        program, *typed = typed_command(ctx)
        report: dict[str, Any] = run(cluster, "reconstruct", points, target, words, typed)
        report["command"] = shlex.join([program, *typed])  # the head has typed its own
        _show(ctx, report, target, points)
    return {name: value for name, value in report.items() if is_detailed or name not in DETAILS}


def _check_shown(ctx: click.Context) -> None:
    """Refuse a page or a picture of a mesh that could not be read again here."""
    suffix = Path(ctx.params["output"]).suffix.lower()
    for name in ("report", "png"):
        if ctx.params[name] is not None and suffix not in ("", *MESH_SUFFIXES):
            raise UsageError(
                f"--{name} of a {suffix} that a cluster makes: it is not read here",
                f"write {', '.join(MESH_SUFFIXES)}, or leave --{name} out",
            )


def _show(ctx: click.Context, report: dict[str, Any], mesh: Path, points: Path) -> None:
    """Write the page and the picture of a mesh that has been fetched."""
    page, png = ctx.params["report"], ctx.params["png"]
    if page is None and png is None:
        return
    from hpcapp.applications.surface.job.report_page import show_files, write_job_page
    from hpcapp.pages.picture import write_picture
    from hpcapp.pages.report import check_report

    check_report(report, "the head's report")
    shown = show_files(mesh, points, report)
    if png is not None:
        write_picture(png, shown.mesh)
    if page is not None:
        write_job_page(page, shown, report, Path(ctx.params["output"]).name)
