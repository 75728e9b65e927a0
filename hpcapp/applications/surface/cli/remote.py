"""A reconstruction that another machine runs."""

from __future__ import annotations

import shlex
from collections.abc import Collection
from dataclasses import field
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np

from hpcapp.alignment.place import choose_place
from hpcapp.applications.surface.job.source import MARGIN
from hpcapp.applications.surface.methods.options import typed_command, typed_options
from hpcapp.applications.surface.normals.viewpoint import parse_viewpoint, type_viewpoint
from hpcapp.backends.cluster import load_cluster_function
from hpcapp.io import FOLDER_SUFFIXES, MESH_SUFFIXES, drop_unusable, read_points
from hpcapp.io.crs import Crs
from hpcapp.io.output import open_output
from hpcapp.io.placement import Place, note_origin
from hpcapp.io.points.inputs import gather_points
from hpcapp.io.registry import find_mesh_writer
from hpcapp.parts.crop import CROPPED, parse_crop
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError, UsageError
from hpccomponent.foreign_json import convert

DETAILS = ("timeline", "owners")
"""What a report has with --details."""

OF_THIS_MACHINE = (
    "points",
    "sample",
    "align",
    "output",
    "cluster",
    "events",
    "report",
    "png",
    "as_json",
)
"""What options name here; on the head they are the job's own."""

_FILES = {
    "events": "its jobs keep their events by themselves",
    "trace": "give it to 'hpcapp submit' behind --: it lies in the job's folder then",
}


def check_file(output: str) -> None:
    """Raise UsageError where an output is a folder: one file is fetched from a cluster."""
    if Path(output).suffix.lower() in FOLDER_SUFFIXES:
        raise UsageError(
            f"{output}: is a folder, and one file comes from a cluster",
            f"write {', '.join(MESH_SUFFIXES)} or .3mf",
        )


def check_points(points: Path, sample: int | None = None) -> None:
    """Read the points as the job will; InputError where it could not use them.

    Of a mesh so many points on its faces are taken. Raises UsageError where the suffix is unknown.
    """
    with gather_points([str(points)], sample, for_surface=True) as path:
        drop_unusable(read_points(path), str(path))


def type_for_head(ctx: click.Context, without: Collection[str]) -> list[str]:
    """Return the options that were typed, with what is in the files that they name.

    Those whose parameters are named in `without` are left out.
    """
    words = typed_options(ctx, (*without, "viewpoint", "polygon"))
    crop = parse_crop(*(ctx.params[name] for name in CROPPED))
    if crop.polygon:
        words += ["--polygon", crop.polygon]
    return words + type_viewpoint(parse_viewpoint(ctx.params["viewpoint"]))


def run_on_cluster(ctx: click.Context) -> dict[str, Any]:
    """Have a cluster's head run the job with the options that were typed, and fetch the mesh.

    Returns the job's report. Raises HpcError, whatever went wrong, here or there.
    """
    names, cluster = ctx.params["points"], ctx.params["cluster"]
    for name, instead in _FILES.items():
        if ctx.params[name] is not None:
            raise UsageError(f"--{name} means nothing to a cluster file", instead)
    run = load_cluster_function("run")
    crop = parse_crop(*(ctx.params[name] for name in CROPPED))
    check_file(ctx.params["output"])
    _check_shown(ctx)
    with (
        open_output(ctx.params["output"]) as target,
        gather_points(
            names,
            ctx.params["sample"],
            for_surface=True,
            goes_elsewhere=True,
            keeps_noise=crop.keeps_noise,
            choose=partial(crop.narrow, margin=MARGIN),
            place=choose_place(ctx.params["align"]),
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
        _note_place(target, report)
        _show(ctx, report, target, points)
    return {name: value for name, value in report.items() if is_detailed or name not in DETAILS}


@dataclass(frozen=True, slots=True)
class _Meaning:
    """What a report says of the input's coordinates."""

    crs: str | None = None
    unit: str | None = None
    height_unit: str | None = None


@dataclass(frozen=True, slots=True)
class _Placed:
    """What a report says of where the mesh was written."""

    origin: Place = (0.0, 0.0, 0.0)
    input: _Meaning = field(default_factory=_Meaning)


def _note_place(target: Path, report: dict[str, Any]) -> None:
    """Write beside a mesh that was fetched what its file does not say of its place."""
    try:
        placed = convert(report, _Placed)
    except ValueError as error:
        raise InputError(f"the head's report: {error}", "check the head") from None
    crs = Crs(placed.input.crs, placed.input.unit, placed.input.height_unit)
    mesh_writer = find_mesh_writer(target)
    note_origin(target, np.array(placed.origin), crs, holds_crs=not mesh_writer.is_bare)


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
    from hpcapp.applications.surface.steps.report_page import find_up, show_files, write_job_page
    from hpcapp.pages.picture import write_picture
    from hpcapp.pages.report import check_report

    check_report(report, "the head's report")
    shown = show_files(mesh, points, report)
    if png is not None:
        write_picture(png, shown.mesh, up=find_up(report, shown.mesh))
    if page is not None:
        write_job_page(page, shown, report, Path(ctx.params["output"]).name)
