"""The verb ``compare``: how far a mesh is from the truth.

This module is imported for every ``--help``: numpy and all that stands on it are imported inside.
"""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hpcapp.applications.view.command import check_page
from hpccomponent.cli.terminal import echo, echo_json
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import InputError

if TYPE_CHECKING:
    from hpcapp.applications.compare.metrics import Measures
    from hpcapp.progress import StageClock


log = logging.getLogger("hpcapp")

_THRESHOLDS = (0.02, 0.1, 0.5)


@click.command(
    cls=Verb,
    examples=[
        (
            "hpcapp compare mesh.ply truth.ply",
            "Print the distances, and the share within thresholds.",
        ),
        (
            "hpcapp compare mesh.ply shape:knot --json",
            "Measure against a model of 'hpcapp simulate'.",
        ),
        (
            "hpcapp compare mesh.ply scan.laz --html compare.html",
            "Show on a page where the mesh is off its points.",
        ),
    ],
)
@click.argument(
    "mesh", type=click.Path(dir_okay=False, path_type=Path), help="The mesh to be judged."
)
@click.argument("truth", help="A mesh, points, or shape:NAME, a model of 'hpcapp simulate'.")
@click.option(
    "--samples",
    type=click.IntRange(100, 10_000_000),
    default=50_000,
    show_default=True,
    metavar="N",
    help="Points on either surface.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, metavar="N",
              help="One seed gives one result.")  # fmt: skip
@click.option(
    "--threshold",
    "thresholds",
    type=click.FloatRange(0, min_open=True),
    multiple=True,
    default=_THRESHOLDS,
    show_default=True,
    metavar="PERCENT",
    help="Of an F-score, in per cent of the diagonal; may be given several times.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on standard output.")
@click.option(
    "--html",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="PAGE",
    help="Write a page with the mesh, coloured by its distance.",
)
def compare(
    mesh: Path,
    truth: str,
    samples: int,
    seed: int,
    thresholds: tuple[float, ...],
    as_json: bool,
    html: Path | None,
) -> None:
    """Measure the distances between a mesh and the truth.

    Distances are taken from points spread evenly over either surface to the other surface, exactly,
    and are in per cent of the diagonal of TRUTH's bounding box.
    """
    check_page(html, "--html")
    from hpcapp.applications.compare.metrics import as_json as to_json
    from hpcapp.progress import Progress, StageClock
    from hpcapp.progress_display import open_progress

    with open_progress(sys.stderr) as display:
        clock = StageClock(Progress(display))
        measures, unit = _compare(mesh, truth, samples, seed, thresholds, html, clock)
    if as_json:
        echo_json(to_json(measures))
    else:
        echo(_tabulate(measures, unit))
    if html is not None:
        log.info("%s: the mesh, coloured by its distance", html)


def _compare(
    mesh: Path,
    truth: str,
    samples: int,
    seed: int,
    thresholds: tuple[float, ...],
    html: Path | None,
    clock: StageClock,
) -> tuple[Measures, str]:
    """Return the measures and the unit of length, and write the page that is asked for."""
    from hpcapp.applications.compare.metrics import measure_mesh
    from hpcapp.applications.compare.truth import check_usable, open_truth
    from hpcapp.io import read_mesh

    with clock.stage("read"):
        surface = read_mesh(mesh)
        check_usable(surface, mesh)
        reference = open_truth(truth, surface.origin)
    if reference.diagonal == 0.0:
        raise InputError(
            f"{truth}: all of it is at one place, so that nothing can be measured by its size",
            "give a truth with an extent",
        )
    measures = measure_mesh(surface, reference, samples, seed, thresholds, clock)
    if html is not None:
        from hpcapp.applications.compare.page import make_comparison
        from hpcapp.pages.page import write_page

        with clock.stage("show"):
            write_page(html, make_comparison(mesh, truth, surface, reference, measures))
    return measures, reference.unit


def _tabulate(measures: Measures, unit: str) -> str:
    """Return the measures as tables for people, a column each for what is measured alike."""
    from hpcapp.applications.compare.page import (
        list_agreement,
        list_lengths,
        list_topology,
        say_openness,
    )

    lengths = [("", "length", "% of diagonal"), *list_lengths(measures, unit)]
    others = [*list_agreement(measures).items(), *list_topology(measures).items()]
    width = max(len(row[0]) for row in [*lengths, *others])
    wide = max(len(row[1]) for row in [*lengths, *others])
    lines = [f"{name:{width}}  {length:>{wide}}  {share:>13}" for name, length, share in lengths]
    lines += [f"{name:{width}}  {value:>{wide}}" for name, value in others]
    if openness := say_openness(measures):
        lines.append(openness)
    return "\n".join(lines)
