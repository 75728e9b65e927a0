"""The verb ``reproduce``: the paper's figures and its Table 1, made again.

This module is imported for every ``--help``: numpy and all that stands on it are imported inside.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from hpcapp.named_files import SCAN
from hpccomponent.cli.named_files import InputFile, OutputFile
from hpccomponent.cli.terminal import echo
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import OutputError, UsageError
from hpccomponent.files.outputs import Role, Written

if TYPE_CHECKING:
    from hpcapp.lab.reproduce.finding import Finding
    from hpcapp.lab.reproduce.subject import Subject
    from hpcapp.progress import StageClock


log = logging.getLogger("hpcapp")

#: Which options each figure has. Nothing is up in plots; who makes all figures types one line.
_OPTIONS = {
    "fig2": ("up",),
    "fig4": ("up",),
    "fig6": ("up",),
    "fig7-8": ("up", "workers", "rounds", "grid"),
    "table1": ("up", "grid", "cluster"),
}
_GRIDS = {"fig7-8": 128, "table1": 64}
_EMULATED = "table1.yaml"  # the cluster file that is written where none is given


def _list_figures(name: str, option: str, params: Mapping[str, Any]) -> Iterator[Written]:
    """Yield the pictures and tables in the folder of a figure."""
    figure = params["figure"]
    files = [
        f"{one}{suffix}"
        for one in (("fig7", "fig8") if figure == "fig7-8" else (figure,))
        for suffix in (".png", ".md")
    ]
    if figure == "table1" and params["cluster"] is None:
        files.append(_EMULATED)
    for file in files:
        yield Written(Path(name, file), option, makes_folders=True)


@click.command(
    cls=Verb,
    examples=[
        ("hpcapp reproduce fig2", "Draw Figure 2, and print its table."),
        ("hpcapp reproduce fig6 scan.ply --out figures --up y", "Make Figure 6 of another scan."),
        ("hpcapp reproduce table1 --cluster lab.yaml", "Make Table 1 on a cluster of your own."),
    ],
)
@click.argument(
    "figure", type=click.Choice(list(_OPTIONS)), metavar="FIGURE", help="Which, as above."
)
@click.argument(
    "points",
    type=SCAN,
    required=False,
    help="A point cloud of any format that is read; a simulated scan without.",
)
@click.option(
    "--out",
    type=OutputFile("folder", role=Role.SCRATCH, lists=_list_figures),
    default=Path(),
    metavar="DIR",
    help="Folder for FIGURE.png and FIGURE.md.  [default: this one]",
)
@click.option("--up", type=click.Choice(["x", "y", "z"]), default="z", show_default=True,
              help="The axis that points up in pictures of the cloud.")  # fmt: skip
@click.option(
    "--grid",
    type=click.IntRange(16, 1024),
    metavar="N",
    help="Cells along the longest side.  [default: 128; 64 for table1]",
)
@click.option("--workers", type=click.IntRange(1, 64), default=4, show_default=True,
              metavar="N", help="Most workers of fig7-8.")  # fmt: skip
@click.option("--rounds", type=click.IntRange(1, 1000), default=3, show_default=True,
              metavar="N", help="Runs with each number of workers.")  # fmt: skip
@click.option(
    "--cluster",
    type=InputFile(),
    metavar="FILE",
    help="Cluster file of table1.  [default: four emulated machines]",
)
@click.pass_context
def reproduce(
    ctx: click.Context,
    figure: str,
    points: Path | None,
    out: Path,
    up: str,
    grid: int | None,
    workers: int,
    rounds: int,
    cluster: Path | None,
) -> None:
    """Make the paper's figures and its Table 1 again.

    Each is a picture, and a table beside the paper's numbers.

    \b
    fig2    from points to a surface: input, patches, quadrics, surface
    fig4    patches by the most points that each may hold
    fig6    the surface at 24, 64 and 256 cells, by both methods
    fig7-8  time and speed-up by the number of workers: fits handed out, and tiles
    table1  one head that works and three workers, deployed
    """  # noqa: D301 - click's mark
    _check_options(ctx, figure)
    cells = grid or _GRIDS.get(figure, 0)
    if figure != "table1":
        from hpcapp.lab.reproduce.panels import check_plots

        check_plots()
    from hpcapp.lab.reproduce.subject import open_subject
    from hpcapp.progress import Progress, StageClock
    from hpcapp.progress_display import open_progress

    with open_subject(points) as subject, open_progress(sys.stderr) as display:
        _make_folder(out)
        clock = StageClock(Progress(display))
        if figure == "fig7-8":
            findings = _plot(subject, (cells, rounds, workers), out, clock)
        elif figure == "table1":
            findings = {figure: _deploy(subject, cluster, (cells, up), out, clock)}
        else:
            findings = {figure: _draw(figure, subject, up, out, clock)}
    for name, finding in findings.items():
        page = finding.to_markdown(f"{name}.png")
        _write_page(out / f"{name}.md", page)
        echo(page.rpartition("\n![")[0])
        log.info("%s.png: the picture; %s.md: the table", out / name, out / name)


def _check_options(ctx: click.Context, figure: str) -> None:
    """Refuse an option that was typed and that the figure does not have."""
    for name in ("up", "grid", "workers", "rounds", "cluster"):
        typed = ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if typed and name not in _OPTIONS[figure]:
            having = ", ".join(other for other, names in _OPTIONS.items() if name in names)
            raise UsageError(f"--{name} means nothing to {figure}", f"it is for {having}")


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"{out}: {error.strerror or error}", "name another folder with --out"
        ) from error


def _draw(figure: str, subject: Subject, up: str, out: Path, clock: StageClock) -> Finding:
    """Make Figure 2, 4 or 6."""
    from hpcapp.pages.png import write_png

    if figure == "fig2":
        from hpcapp.lab.reproduce.construction import make_figure_2 as make
    elif figure == "fig4":
        from hpcapp.lab.reproduce.patches import make_figure_4 as make
    else:
        from hpcapp.lab.reproduce.surfaces import make_figure_6 as make
    finding, pixels = make(subject, up, clock)
    write_png(out / f"{figure}.png", pixels)
    return finding


def _deploy(
    subject: Subject, cluster: Path | None, looks: tuple[int, str], out: Path, clock: StageClock
) -> Finding:
    """Make Table 1 at the grid and with the up axis of `looks`."""
    from hpcapp.lab.reproduce.deployment import make_table_1, write_local_cluster
    from hpcapp.pages.png import write_png

    file = cluster or out / _EMULATED
    if cluster is None:
        write_local_cluster(file)
    finding, pixels = make_table_1(subject, file, *looks, clock, is_emulated=cluster is None)
    write_png(out / "table1.png", pixels)
    return finding


def _plot(
    subject: Subject, sizes: tuple[int, int, int], out: Path, clock: StageClock
) -> dict[str, Finding]:
    """Measure `sizes` (grid, rounds, most workers) once, and draw both figures."""
    from hpcapp.io.staging import replacing
    from hpcapp.lab.reproduce.plots import make_figure_7, make_figure_8
    from hpcapp.lab.reproduce.scaling import measure
    from hpccomponent.limits import available_cores

    grid, rounds, most = sizes
    with clock.stage(f"{rounds} x 0 to {most} workers"):
        runs = list(measure(subject.path, grid, rounds, most, done=clock.progress.advance))
    title = f"{subject.name}, grid {grid}"
    findings = {}
    for name, make in (("fig7", make_figure_7), ("fig8", make_figure_8)):
        with replacing(out / f"{name}.png") as file:
            findings[name] = make(runs, title, available_cores(), file)
    return findings


def _write_page(path: Path, page: str) -> None:
    from hpcapp.io.staging import replacing

    with replacing(path) as file:
        file.write(page.encode())
