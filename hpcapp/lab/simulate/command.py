"""The verb of the virtual scanner: ``simulate``.

This module is imported for every ``--help``: numpy and all that stands on it are imported inside.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from hpccomponent.cli.named_files import OutputFile
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import UsageError
from hpccomponent.files.outputs import Written

log = logging.getLogger("hpcapp")

DEFAULT = ParameterSource.DEFAULT
SCENES = ("terrain", "yard", "heap", "forest", "town", "room", "object")
SCANNERS = ("airborne", "terrestrial", "handheld", "structured-light")
RAW_OPTIONS = {"flying", "strays"}
SCENE_OPTIONS = {"points", "noise", "drift", "seed", *RAW_OPTIONS}
GROUPS = {
    "Any scan": ("shape", "scene", "output", "points", "noise", "drift", "seed"),
    "A model's scan": (
        "views", "normals", "correlation", "dropout", "grazing", "pose_error", "outliers",
        "density_ratio", "missing", "flipped",
    ),
    "A scene's scan": ("scanner", "flying", "strays"),
}  # fmt: skip


def _list_scan(name: str, option: str, params: Mapping[str, Any]) -> Iterator[Written]:
    """Yield the points, and of a scene the truth and the trajectory beside them."""
    from hpcapp.io.output import list_mesh_files, list_point_files

    output = Path(name)
    yield from list_point_files(output, option)
    if params["scene"] is not None:
        truth, trajectory = _name_beside(output)
        for one in (*list_mesh_files(truth, option), Written(trajectory, option)):
            yield replace(one, is_beside=True)


def _name_beside(output: Path) -> tuple[Path, Path]:
    """Return the files of a scene's truth and of the scanner's trajectory."""
    return (
        output.with_name(f"{output.stem}_truth.ply"),
        output.with_name(f"{output.stem}_trajectory.csv"),
    )


def _complete_shape(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    """Return the names of models that begin so."""
    del ctx, param
    from hpcapp.lab.simulate.shapes import SHAPES

    return [name for name in SHAPES if name.startswith(incomplete)]


def _number(
    names: str, default: float, meaning: str
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return an option of a whole number, or of any: its default is one."""
    kind, metavar = (int, "N") if isinstance(default, int) else (float, "F")
    return click.option(
        *names.split(),
        type=kind, metavar=metavar, default=default, show_default=True, help=meaning,
    )  # fmt: skip


@click.command(
    cls=Verb,
    groups=GROUPS,
    examples=[
        (
            "hpcapp simulate --shape knot -o knot.ply",
            "Scan a model from 20 places: 100,000 points.",
        ),
        (
            "hpcapp simulate --shape gear --noise 0.002 --outliers 0.01 -o gear.ply",
            "The same with noise, and with one wrong point in a hundred.",
        ),
        (
            "hpcapp simulate --scene town --scanner airborne -n 500000 -o town.laz",
            "Fly over a town.",
        ),
    ],
)
@click.option(
    "--shape",
    metavar="NAME",
    shell_complete=_complete_shape,
    help="Which model; an unknown name lists all.",
)
@click.option("--scene", type=click.Choice(SCENES), help="A raw scan, with its truth beside it.")
@click.option(
    "--scanner",
    type=click.Choice(SCANNERS),
    help="Which scanner; the usual one of the scene without.",
)
@click.option(
    "-o",
    "--output",
    required=True,
    type=OutputFile("points", lists=_list_scan),
    help="Point cloud to write.",
)
@_number("-n --points", 100_000, "Number of points.")
@_number("--views", 20, "Positions of the scanner; 0 samples the whole surface evenly.")
@_number(
    "--noise",
    0.0,
    "Depth noise (standard deviation), as a fraction of the diagonal. "
    "Of a scene: a length, and the scanner's own without the option.",
)
@_number(
    "--drift",
    0.0,
    "Smooth error of each view's depth (standard deviation), as a fraction of the diagonal. "
    "Of a scene: error of the scanner's position, a length.",
)
@_number("--correlation", 0.05, "Length over which --drift changes, as a fraction of the diagonal.")
@_number("--dropout", 0.0, "Share of each view that is lost, in blotches.")
@_number("--grazing", 80.0, "Greatest angle of incidence that still echoes, in degrees.")
@_number("--pose-error", 0.0, "Misplacement of each view, as a fraction of the diagonal.")
@_number("--outliers", 0.0, "Share of points that are wrong, near and far.")
@_number("--density-ratio", 1.0, "Density at the dense end over that at the sparse end.")
@_number("--missing", 0, "Balls from which nothing came back.")
@_number("--flipped", 0.0, "Share of points whose normal has the wrong sign.")
@click.option(
    "--normals",
    type=click.Choice(["pca", "exact"]),
    default="pca",
    show_default=True,
    help="From the neighbours' plane, or the model's own.",
)
@_number("--flying", 0.0, "Share of points in the air behind an edge.")
@_number("--strays", 0.0, "Share of points that are wrong, near and far.")
@_number("--seed", 0, "One seed gives one scan.")
@click.pass_context
def simulate(
    ctx: click.Context,
    /,
    shape: str | None,
    scene: str | None,
    scanner: str | None,
    output: Path,
    **settings: Any,
) -> None:
    """Scan a model or a scene whose true surface is known.

    Writes the points, and of a scene its true surface and the scanner's way, too.
    """
    given = {name for name in settings if ctx.get_parameter_source(name) is not DEFAULT}
    if scene is not None:
        _refuse(given - SCENE_OPTIONS, "is for a model alone", "leave out --scene, or this")
        _refuse(
            {"shape"} if shape and scene != "object" else set(), "is for an object", "leave it out"
        )
        chosen = {name: settings[name] for name in given} | ({"shape": shape} if shape else {})
        _write_scene(output, scene, scanner, chosen)
        return
    given |= {"scanner"} if scanner else set()
    _refuse(given & {"scanner", *RAW_OPTIONS}, "is for a scene", "add --scene, or leave it out")
    if shape is None:
        raise UsageError("there is nothing to scan", "name a model by --shape, or a --scene")
    _write_model(output, shape, {n: v for n, v in settings.items() if n not in RAW_OPTIONS})


def _refuse(names: set[str], problem: str, advice: str) -> None:
    if names:
        raise UsageError(f"--{min(names).replace('_', '-')} {problem}", advice)


def _write_model(output: Path, shape: str, settings: dict[str, Any]) -> None:
    from hpcapp.io import write_points
    from hpcapp.lab.simulate.scanner import simulate_scan
    from hpcapp.lab.simulate.settings import ScanSettings
    from hpcapp.lab.simulate.shapes import find_shape

    cloud = simulate_scan(find_shape(shape), ScanSettings(**settings))
    write_points(output, cloud)
    log.info("%s: %d points of %s", output, len(cloud), shape)


def _write_scene(output: Path, scene: str, scanner: str | None, settings: dict[str, Any]) -> None:
    """Write the points, and beside them the truth and the trajectory."""
    from hpcapp.io import write_mesh, write_points
    from hpcapp.io.rows import write_rows
    from hpcapp.io.staging import replacing
    from hpcapp.lab.simulate.raw.scan import RawSettings, scan_scene

    truth, trajectory = _name_beside(output)
    raw = scan_scene(scene, scanner, RawSettings(**settings))
    write_points(output, raw.cloud)
    write_mesh(truth, raw.truth)
    with replacing(trajectory) as file:
        file.write(b"time,x,y,z\n")
        file.writelines(write_rows("%.6f,%.6f,%.6f,%.6f\n", raw.trajectory))
    log.info("%s: %d points of a scene: %s", output, len(raw.cloud), scene)
    log.info("%s: the surface, %d triangles", truth, len(raw.truth.faces))
    log.info("%s: %d places of the scanner", trajectory, len(raw.trajectory))
