"""The verb ``quadrature``, registered as an entry point ``hpc.commands``."""

from __future__ import annotations

import click

from hpccomponent.terminal import echo

__all__ = ["quadrature"]


@click.command()
@click.argument("integrand")
@click.argument("left", type=float)
@click.argument("right", type=float)
@click.option(
    "--tolerance", type=float, default=1e-9, show_default=True, help="Largest absolute error."
)
@click.option(
    "--backend",
    default="serial",
    metavar="NAME",
    show_default=True,
    help="Where intervals are estimated; see 'hpcapp reconstruct --help'.",
)
@click.option("--workers", type=click.IntRange(1, 1024), help="How many workers.")
def quadrature(
    integrand: str, left: float, right: float, tolerance: float, backend: str, workers: int | None
) -> None:
    """Integrate INTEGRAND (peak, root or wave) from LEFT to RIGHT: the tutorial's application."""
    from hpcapp.applications.quadrature.application import integrate
    from hpcapp.backends.selection import open_executor

    with open_executor(backend, workers=workers) as opened:
        result = integrate(integrand, left, right, tolerance, opened.workforce)
    echo(f"{result.value:.12g} ± {result.error:.1g} from {result.intervals} intervals")
