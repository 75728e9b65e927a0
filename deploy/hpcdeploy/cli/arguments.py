"""Arguments that several verbs of clusters have."""

from __future__ import annotations

from pathlib import Path

import click

PATH = click.Path(dir_okay=False, path_type=Path)
FILE = click.argument("file", type=PATH, help="The cluster file (.yaml).")
FILES = click.argument(
    "files",
    nargs=-1,
    type=PATH,
    help="Cluster files (.yaml); without one, the AWS account of the environment.",
)
JOB = click.argument(
    "job",
    required=False,
    help="Number of the job, as 'hpcapp jobs' lists it; the last one without.",
)
