"""The verb ``compare``: how far a mesh is from the truth, or what changed between two epochs.

This module is imported for every ``--help``: numpy and all that stands on it are imported inside.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from hpcapp.named_files import FILE_OR_WORD, PAGE, PICTURE, SCAN, SCAN_OR_WORD
from hpccomponent.cli.named_files import OutputFile, json_option
from hpccomponent.cli.terminal import align_rows, echo, echo_json
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import InputError, UsageError

if TYPE_CHECKING:
    from hpcapp.applications.compare.metrics import Measures
    from hpcapp.progress import StageClock


log = logging.getLogger("hpcapp")

_THRESHOLDS = (0.02, 0.1, 0.5)
GROUPS = {
    "Distances": ("samples", "seed", "thresholds"),
    "Volumes": ("is_volume", "up", "cell", "registration", "png"),
    "Heaps, with --volume": ("above", "polygon", "csv"),
    "Both": ("as_json", "html"),
}


@click.command(
    cls=Verb,
    groups=GROUPS,
    examples=[
        (
            "hpcapp compare mesh.ply truth.ply --html compare.html",
            "Print the distances, and show on a page where the mesh is off.",
        ),
        (
            "hpcapp compare june.laz may.laz --volume --png change.png",
            "Measure what was cut and filled since.",
        ),
        (
            "hpcapp compare yard.laz --volume --above rim --polygon toes.geojson",
            "Measure each heap above the ground round it.",
        ),
    ],
)
@click.argument(
    "mesh",
    type=SCAN,
    help="The mesh to be judged; of volumes the new mesh or points, or those with the heaps.",
)
@click.argument(
    "truth",
    type=SCAN_OR_WORD,
    required=False,
    help="A mesh, points, or shape:NAME, a model of 'hpcapp simulate'; of volumes the old mesh or "
    "points. None with --above.",
)
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
@click.option("--volume", "is_volume", is_flag=True,
              help="Measure cut, fill and net volume between two epochs.")  # fmt: skip
@click.option("--up", type=click.Choice(["x", "y", "z"]), default="z", show_default=True,
              help="The axis that points up.")  # fmt: skip
@click.option(
    "--cell",
    type=click.FloatRange(0, min_open=True),
    metavar="LENGTH",
    help="Width of a cell of terrain, seen from above.  [default: as the sparser epoch needs]",
)
@click.option(
    "--registration",
    type=click.FloatRange(0),
    metavar="LENGTH",
    help="Standard deviation of the shift between both, as control points tell it, or of a polygon "
    "against its heap.  [default: the shift where nothing changed; polygons are widened as long as "
    "heaps go on]",
)
@click.option(
    "--above",
    metavar="BASE",
    help="Measure heaps above a base: rim (what the ground round each is continued to), plane (the "
    "plane through it), or a height.",
)
@click.option(
    "--polygon",
    type=FILE_OR_WORD,
    metavar="FILE",
    help="The toes of the heaps: polygons of a .geojson, .wkt or .shp, or WKT itself.",
)
@click.option("--csv", type=OutputFile("table", (".csv",)), metavar="FILE",
              help="Write the heaps as a table, too.")  # fmt: skip
@click.option("--png", type=PICTURE, metavar="FILE", help="Draw what changed into a picture.")
@json_option()
@click.option(
    "--html",
    type=PAGE,
    metavar="PAGE",
    help="Write a page with the mesh, coloured by its distance or by what changed.",
)
@click.pass_context
def compare(
    ctx: click.Context,
    /,
    mesh: Path,
    truth: str | None,
    samples: int,
    seed: int,
    thresholds: tuple[float, ...],
    is_volume: bool,
    up: str,
    cell: float | None,
    registration: float | None,
    above: str | None,
    polygon: str | None,
    csv: Path | None,
    png: Path | None,
    as_json: bool,
    html: Path | None,
) -> None:
    """Measure distances from the truth, or volumes that changed.

    Distances are taken from points spread evenly over either surface to the other surface, exactly,
    and are in per cent of the diagonal of TRUTH's bounding box. Volumes (--volume) lie between
    MESH, the new epoch, and TRUTH, the old one, or are those of heaps above the ground round them.
    """
    kind, other = ("Distances", "Volumes") if is_volume else ("Volumes", "Distances")
    for name in GROUPS[kind]:
        if ctx.get_parameter_source(name) is not ParameterSource.DEFAULT:
            flag = "--threshold" if name == "thresholds" else f"--{name}"
            raise UsageError(
                f"{flag} is for {kind.lower()}, not for {other.lower()}",
                "leave it out" if is_volume else "add --volume, or leave it out",
            )
    if above is not None or polygon is not None or csv is not None:
        others = {"TRUTH": truth, "--html": html, "--png": png, "--up": up if up != "z" else None}
        _refuse_beside_heaps(is_volume, above, polygon, others)
        _measure_heaps(str(mesh), above or "", polygon or "", cell, registration, csv, as_json)
        return
    if truth is None:
        raise UsageError("nothing to compare with", "give TRUTH; of a heap --above and --polygon")
    if is_volume:
        _measure_volume(str(mesh), truth, up, cell, registration, png, html, as_json)
        return
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


def _refuse_beside_heaps(
    is_volume: bool, above: str | None, polygon: str | None, others: Mapping[str, object]
) -> None:
    if not is_volume or above is None or polygon is None:
        raise UsageError(
            "a heap needs --volume, --above and --polygon",
            "give all three, as in --volume --above rim --polygon toes.geojson",
        )
    for name, value in others.items():
        if value is not None:
            raise UsageError(f"{name} stands beside --above", "leave one of them out")


def _measure_heaps(
    name: str,
    above: str,
    polygon: str,
    cell: float | None,
    registration: float | None,
    csv: Path | None,
    as_json: bool,
) -> None:
    from hpcapp.applications.compare.volume import heaps as tables
    from hpcapp.applications.compare.volume.heap import measure_heaps
    from hpcapp.io.outlines import read_polygons
    from hpcapp.progress import Progress, StageClock
    from hpcapp.progress_display import open_progress
    from hpcapp.terrain.epoch import open_epoch

    polygons = read_polygons(polygon)
    with open_progress(sys.stderr) as display:
        clock = StageClock(Progress(display))
        with clock.stage("read"):
            ground = open_epoch(name)
        with clock.stage("measure"):
            heaps = measure_heaps(ground, polygons, above, cell, registration)
    unit = ground.crs.unit or ""
    if csv is not None:
        tables.write_csv(csv, heaps, unit)
    if as_json:
        echo_json({"heaps": tables.list_values(heaps, unit)})
    else:
        for line in align_rows(tables.list_rows(heaps, unit), numbers=True):
            echo(line)
        for note in tables.list_notes(heaps, above, unit):
            echo(note)
    if csv is not None:
        log.info("%s: a table of %d heaps", csv, len(heaps))


def _measure_volume(
    new: str,
    old: str,
    up: str,
    cell: float | None,
    registration: float | None,
    png: Path | None,
    html: Path | None,
    as_json: bool,
) -> None:
    from hpcapp.applications.compare.volume import page
    from hpcapp.applications.compare.volume.epochs import measure_epochs
    from hpcapp.applications.compare.volume.measure import as_json as to_json
    from hpcapp.pages.page import write_page
    from hpcapp.progress import Progress, StageClock
    from hpcapp.progress_display import open_progress
    from hpcapp.terrain.epoch import open_epoch

    with open_progress(sys.stderr) as display:
        clock = StageClock(Progress(display))
        with clock.stage("read"):
            epochs = open_epoch(new), open_epoch(old)
        with clock.stage("measure"):
            measured = measure_epochs(*epochs, up, cell, registration)
        if html is not None or png is not None:
            with clock.stage("show"):
                if html is not None:
                    write_page(html, page.make_page(new, old, measured, up))
                if png is not None:
                    page.write_picture(png, measured, up)
    change, unit = measured.change, measured.unit
    if as_json:
        echo_json(to_json(change, unit))
    else:
        table = [page.HEAD, *page.list_rows(change, unit)]
        for line in align_rows(table, numbers=True):
            echo(line)
        for note in page.list_notes(change, unit):
            echo(note)
    if doubted := page.doubt(change, unit):
        log.warning("%s", doubted)
    for path, what in ((html, "a page"), (png, "a picture")):
        if path is not None:
            log.info("%s: %s of what changed", path, what)


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
    from hpcapp.applications.compare.truth import open_truth
    from hpcapp.io import read_mesh
    from hpcapp.io.usable_mesh import check_usable

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
