"""A reconstruction that another machine runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hpcapp.backends.cluster_jobs import load_cluster_function
from hpcapp.io import drop_unusable, read_points
from hpcapp.io.output import open_output
from hpcapp.io.points.inputs import find_paths, gather_points
from hpccomponent.errors import UsageError

__all__ = ["OF_THIS_MACHINE", "check_points", "run_on_cluster"]

OF_THIS_MACHINE = ("points", "sample", "output", "cluster", "events", "as_json")
"""What options name here; on the head they are the job's own."""

_FILES = {
    "events": "its jobs keep their events by themselves",
    "trace": "give it to 'hpcapp submit' behind --: it lies in the job's folder then",
}


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
    with (
        open_output(ctx.params["output"], files) as target,
        gather_points(names, ctx.params["sample"], goes_elsewhere=True) as points,
    ):
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
        if name == "viewpoints":
            for place in value:
                words += [parameter.opts[-1], ",".join(map(repr, place))]
        elif value is False:
            words.append(parameter.secondary_opts[0])
        else:
            words += [parameter.opts[-1]] if value is True else [parameter.opts[-1], str(value)]
    return words
