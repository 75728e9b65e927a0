"""What can be found out here about a job for another machine, before anything travels.

The package that knows cluster files asks `check_job` by its entry point ``hpc.checks``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from hpcapp.applications.surface.cli.command import check_flags, reconstruct
from hpcapp.applications.surface.cli.remote import (
    OF_THIS_MACHINE,
    check_file,
    check_points,
    type_for_head,
)
from hpccomponent.cli.named_files import list_files
from hpccomponent.errors import UsageError
from hpccomponent.files.outputs import check_files


def check_job(cluster: Path, points: Path, output: Path, options: Sequence[str]) -> list[str]:
    """Find out whether a cluster could do a job, and how its head is told of it.

    Files are on this machine; options are those of `reconstruct`, as they were typed. Returns the
    same for the head, which has no other files of this machine than the points. Raises UsageError
    where the options are wrong or nothing can be written there, InputError where the points are no
    point cloud that can be reconstructed.
    """
    words = ["-o", str(output), "--cluster", str(cluster), str(points.absolute()), *options]
    try:
        ctx = reconstruct.make_context("reconstruct", words)
    except click.UsageError as error:
        problem = error.format_message().rstrip(".")
        raise UsageError(problem, "see 'hpcapp reconstruct --help'") from None
    if ctx.params["points"] != (str(points.absolute()),):
        raise UsageError(
            "submit takes one file of points",
            f"join several: hpcapp convert {points} ... -o joined.ply; options come after --",
        )
    sample = ctx.params["sample"]  # the head takes them from the mesh that it is sent
    same = {"sample": sample, "output": str(output), "cluster": cluster}
    for name in set(OF_THIS_MACHINE) - {"points"}:
        if ctx.params[name] not in (same.get(name), None, False):
            flag = "--json" if name == "as_json" else f"--{name}"
            raise UsageError(f"{flag} is not for the job on the head", "leave it out after --")
    check_flags(ctx)
    check_file(str(output))
    written, read = list_files(ctx)
    check_files([one for one in written if one.option == "-o"], read)  # the others are of the head
    check_points(points, sample)
    return type_for_head(ctx, ("points", "output", "cluster"))
