"""The verb ``init``: a cluster file to start from."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import click

from hpccomponent.cli.named_files import OutputFile
from hpccomponent.cli.terminal import echo, visible_line
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import UsageError

PROVIDERS = ("aws", "eucalyptus", "ec2", "ssh", "local")
"""Of which there is an example, named after it."""


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp init", "Write cluster.yaml, for Amazon EC2."),
        ("hpcapp init lab.yaml --provider ssh", "Write one for machines that are there already."),
        ("hpcapp init demo.yaml --provider local", "Write one that needs no machine but this."),
    ],
)
@click.argument(
    "file", type=OutputFile(), default=Path("cluster.yaml"),
    help="The cluster file to write.  [default: cluster.yaml]",
)  # fmt: skip
@click.option("--provider", type=click.Choice(PROVIDERS), default="aws", show_default=True,
              help="Where the machines are: ec2 is any other cloud that speaks EC2.")  # fmt: skip
@click.option("--force", is_flag=True, help="Replace a file that is there.")
def init(file: Path, provider: str, force: bool) -> None:
    """Write a cluster file with comments, to be changed."""
    example = files("hpcdeploy").joinpath("examples", f"{provider}.yaml").read_text("utf-8")
    try:
        with file.open("w" if force else "x", encoding="utf-8") as stream:
            stream.write(example)
    except FileExistsError:
        raise UsageError(f"{file}: is there already", "give another name, or --force") from None
    echo(visible_line(f"{file}: change what is yours, then: hpcapp plan {file} --offline"))
