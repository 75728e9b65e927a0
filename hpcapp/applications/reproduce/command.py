"""The verb ``reproduce``: the paper's figures and its Table 1, made again.

This module is imported for every ``--help``: numpy and all that stands on it are imported inside.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from hpccomponent.errors import OutputError, UsageError
from hpccomponent.terminal import echo
from hpccomponent.verb import Verb

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hpcapp.applications.reproduce.finding import Finding

__all__ = ["reproduce"]

log = logging.getLogger("hpcapp")

_PLOTS = ("workers", "rounds", "grid")
#: Which options each figure has.
_OPTIONS = {
    "fig2": ("up",),
    "fig4": ("up",),
    "fig6": ("up", "grid"),
    "fig7": _PLOTS,
    "fig8": _PLOTS,
    "table1": ("up", "grid", "cluster"),
}
_GRIDS = {"fig6": 96, "fig7": 128, "fig8": 128, "table1": 64}


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
    type=click.Path(dir_okay=False, path_type=Path),
    required=False,
    help="A point cloud of any format that is read; a simulated scan without.",
)
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path(),
    metavar="DIR",
    help="Folder for FIGURE.png and FIGURE.md.  [default: this one]",
)
@click.option("--up", type=click.Choice(["x", "y", "z"]), default="z", show_default=True,
              help="The axis that points up in the picture.")  # fmt: skip
@click.option(
    "--grid",
    type=click.IntRange(16, 1024),
    metavar="N",
    help="Cells along the longest side.  [default: 128; 96 for fig6, 64 for table1]",
)
@click.option("--workers", type=click.IntRange(1, 64), default=4, show_default=True,
              metavar="N", help="Most workers of fig7 and fig8.")  # fmt: skip
@click.option("--rounds", type=click.IntRange(1, 1000), default=3, show_default=True,
              metavar="N", help="Runs with each number of workers.")  # fmt: skip
@click.option(
    "--cluster",
    type=click.Path(dir_okay=False, path_type=Path),
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
    fig2    patches of the kd-tree, by both readings of the normal cone
    fig4    patches by the most points that each may hold
    fig6    the surface by the paper's method, beside the default method's
    fig7    time by the number of workers: fits handed out, and tiles
    fig8    speed-up by the number of workers: the same
    table1  one head that works and three workers, deployed
    """  # noqa: D301 - click's mark
    _check_options(ctx, figure)
    cells = grid or _GRIDS.get(figure, 0)
    if figure in ("fig7", "fig8"):
        from hpcapp.applications.reproduce.plots import check_plots

        check_plots()
    from hpcapp.applications.reproduce.subject import open_subject

    with open_subject(points) as subject:
        _make_folder(out)
        picture = out / f"{figure}.png"
        if figure in ("fig7", "fig8"):
            finding = _plot(figure, subject.path, subject.name, (cells, rounds, workers), picture)
        else:
            if figure == "fig2":
                from hpcapp.applications.reproduce.patches import make_figure_2

                made = make_figure_2(subject, up)
            elif figure == "fig4":
                from hpcapp.applications.reproduce.patches import make_figure_4

                made = make_figure_4(subject, up)
            elif figure == "fig6":
                from hpcapp.applications.reproduce.surfaces import make_figure_6

                made = make_figure_6(subject, cells, up)
            else:
                from hpcapp.applications.reproduce.deployment import (
                    make_table_1,
                    write_local_cluster,
                )

                file = cluster or out / "table1.yaml"
                if cluster is None:
                    write_local_cluster(file)
                made = make_table_1(subject, file, cells, up, is_emulated=cluster is None)
            finding = _draw(picture, made)
    page = finding.to_markdown(picture.name)
    _write_page(out / f"{figure}.md", page)
    echo(page.rpartition("\n![")[0])
    log.info("%s: the picture; %s.md: the table", picture, out / figure)


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
    from hpcapp.io.staging import check_place

    check_place(out / "reproduced.md")


def _draw(picture: Path, made: tuple[Finding, NDArray[np.uint8]]) -> Finding:
    from hpcapp.pages.png import write_png

    finding, pixels = made
    write_png(picture, pixels)
    return finding


def _plot(
    figure: str, cloud: Path, name: str, sizes: tuple[int, int, int], picture: Path
) -> Finding:
    """Measure `sizes` (grid, rounds, most workers), and draw."""
    from hpcapp.applications.reproduce.plots import make_figure_7, make_figure_8
    from hpcapp.applications.reproduce.scaling import measure
    from hpcapp.io.staging import replacing
    from hpccomponent.limits import available_cores

    grid, rounds, most = sizes

    def tell(number: int, workers: int) -> None:
        log.info("round %d of %d: %s workers", number + 1, rounds, workers or "no")

    runs = list(measure(cloud, grid, rounds, most, done=tell))
    make = make_figure_7 if figure == "fig7" else make_figure_8
    with replacing(picture) as file:
        return make(runs, f"{name}, grid {grid}", available_cores(), file)


def _write_page(path: Path, page: str) -> None:
    from hpcapp.io.staging import replacing

    with replacing(path) as file:
        file.write(page.encode())
