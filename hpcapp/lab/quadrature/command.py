"""The verb ``quadrature``, registered as an entry point ``hpc.commands``."""

from __future__ import annotations

import click

from hpccomponent.cli.terminal import echo
from hpccomponent.cli.verb import Verb


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp quadrature peak 0 1", "Integrate a narrow peak from 0 to 1."),
        ("hpcapp quadrature wave 0 10 --tolerance 1e-12", "Integrate more precisely."),
        ("hpcapp quadrature root 0 1 --backend zmq --workers 2", "Integrate on two workers."),
    ],
)
@click.argument("integrand", help="peak, root or wave.")
@click.argument("left", type=float, help="Where it begins.")
@click.argument("right", type=float, help="Where it ends.")
@click.option(
    "--tolerance",
    type=float,
    metavar="F",
    default=1e-9,
    show_default=True,
    help="Largest absolute error.",
)
@click.option(
    "--backend",
    default="serial",
    metavar="NAME",
    show_default=True,
    help="Where intervals are estimated; see 'hpcapp reconstruct --help'.",
)
@click.option("--workers", type=click.IntRange(1, 1024), metavar="W", help="How many workers.")
def quadrature(
    integrand: str, left: float, right: float, tolerance: float, backend: str, workers: int | None
) -> None:
    """Integrate a function, as an example of an application.

    It is the one that the documentation builds in "Write an application".
    """
    from hpcapp.backends.selection import open_executor
    from hpcapp.lab.quadrature.application import integrate

    with open_executor(backend, workers=workers) as opened:
        result = integrate(integrand, left, right, tolerance, opened.workforce)
    echo(f"{result.value:.12g} ± {result.error:.1g} from {result.intervals} intervals")
