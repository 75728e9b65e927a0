"""A reconstruction that another machine runs: what can be found out here before anything travels.

The package that knows cluster files asks `check_job` by its entry point ``hpc.checks``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from hpcapp.applications.surface.command import check_flags, reconstruct
from hpcapp.applications.surface.output import open_output
from hpcapp.backends.cluster_jobs import load_cluster_function
from hpcapp.io import drop_unusable, read_points
from hpccomponent.errors import OutputError, UsageError

__all__ = ["check_job", "run_on_cluster"]

OF_THIS_MACHINE = ("points", "output", "cluster", "events", "as_json")
"""What options name here; on the head they are the job's own."""


def check_job(cluster: Path, points: Path, output: Path, options: Sequence[str]) -> None:
    """Find out whether a cluster could do a job.

    Parameters
    ----------
    cluster : pathlib.Path
        The cluster file.
    points, output : pathlib.Path
        What the job reads and writes, on this machine.
    options : sequence of str
        Of `reconstruct`, as they were typed.

    Raises
    ------
    UsageError
        The options are wrong, or nothing can be written there.
    InputError
        The points are no point cloud that can be reconstructed.
    """
    words = ["-o", str(output), "--cluster", str(cluster), str(points.absolute()), *options]
    try:
        ctx = reconstruct.make_context("reconstruct", words)
    except click.UsageError as error:
        problem = error.format_message().rstrip(".")
        raise UsageError(problem, "see 'hpcapp reconstruct --help'") from None
    same = {"points": points.absolute(), "output": str(output), "cluster": cluster}
    for name in OF_THIS_MACHINE:
        if ctx.params[name] not in (same.get(name), None, False):
            flag = "--json" if name == "as_json" else f"--{name}"
            raise UsageError(f"{flag} is not for the job on the head", "leave it out after --")
    check_flags(ctx)
    if str(output) == "-":
        raise OutputError("-o - names no file", "name a file to write to")
    with open_output(str(output), points):
        check_points(points)


def check_points(points: Path) -> None:
    """Read the points as the job will; InputError where it could not use them."""
    drop_unusable(read_points(points), str(points))


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
    points, cluster = ctx.params["points"], ctx.params["cluster"]
    if ctx.params["events"] is not None:
        raise UsageError(
            "--events means nothing to a cluster file", "its jobs keep their events by themselves"
        )
    run = load_cluster_function("run")
    with open_output(ctx.params["output"], points) as target:
        check_points(points)
        report: dict[str, Any] = run(cluster, "reconstruct", points, target, _typed_options(ctx))
    return report


def _typed_options(ctx: click.Context) -> list[str]:
    """Return the options that were typed, but for those that name what is on this machine."""
    words: list[str] = []
    for parameter in ctx.command.params:
        name = parameter.name or ""
        is_typed = ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        if not is_typed or name in OF_THIS_MACHINE:
            continue
        value = ctx.params[name]
        if value is False:
            words.append(parameter.secondary_opts[0])
        else:
            words += [parameter.opts[-1]] if value is True else [parameter.opts[-1], str(value)]
    return words
