"""Arguments that several verbs of clusters have."""

from __future__ import annotations

import click

from hpccomponent.cli.named_files import InputFile

FILE = click.argument("file", type=InputFile(), help="The cluster file (.yaml).")
FILES = click.argument(
    "files",
    nargs=-1,
    type=InputFile(),
    help="Cluster files (.yaml); without one, the AWS account of the environment.",
)
JOB = click.argument(
    "job",
    required=False,
    help="Number of the job, as 'hpcapp jobs' lists it; the last one without.",
)
