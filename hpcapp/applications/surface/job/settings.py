"""What a user asks of a reconstruction, each once, and what follows from it for a cloud.

This module is imported for every ``--help``: numpy and all that stands on it are imported inside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import click

from hpcapp.applications.surface.attributes.choice import AttributeChoice, parse_attributes
from hpcapp.applications.surface.hierarchical.settings import Hierarchical
from hpcapp.applications.surface.methods.method import MAX_GRID, MIN_GRID, MethodSettings
from hpcapp.applications.surface.methods.options import check_options, option
from hpcapp.applications.surface.normals.viewpoint import Viewpoint, parse_viewpoint
from hpcapp.communicator.scheduling.policy import DEFAULT_POLICY, POLICIES
from hpcapp.named_files import FILE_OR_WORD, MESH, PAGE, PICTURE, STORAGE
from hpcapp.parts.crop import Crop
from hpcapp.printing.request import Printing
from hpcapp.simplification.target import Target
from hpcapp.texture.request import LEAST_PIXELS, MOST_PIXELS, Photo
from hpcapp.workforce import Workforce
from hpccomponent.cli.named_files import InputFile
from hpccomponent.dataclass import dataclass
from hpccomponent.limits import available_cores

if TYPE_CHECKING:
    from hpcapp.applications.surface.types.reading import Reading
    from hpcapp.geometry.pieces import PieceChoice
    from hpcapp.geometry.points import PointCloud
    from hpcapp.io.placement import Placement


Preprocess: TypeAlias = "Callable[[PointCloud], PointCloud]"

# Below this many points a second thread costs more than it brings.
THREADS_FROM_POINTS = 100_000


class GridSize(click.ParamType[int | None]):
    """Cells along the longest side, or ``auto``: then it is the method that chooses."""

    name = "cells"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> int | None:
        """Return the number, None for ``auto``; click.BadParameter where it is neither."""
        if value == "auto":
            return None
        try:
            cells = int(value)
        except ValueError:
            cells = 0
        if not MIN_GRID <= cells <= MAX_GRID:
            self.fail(f"{value!r} is not auto, nor from {MIN_GRID} to {MAX_GRID}", param, ctx)
        return cells


def _parse_limit(text: str) -> float:
    from hpcapp.applications.surface.resolution.memory import parse_limit

    return parse_limit(text)


_most_used, _of_points, _of_surface, _of_place = (
    partial(option, group=title) for title in ("Most used", "Points", "Surface", "Where it runs")
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """What a user asks of a reconstruction; its options say what each is.

    Of the others `pieces` and `smallest` tell which pieces of the mesh stay (see `PieceChoice`),
    `origin` and `up` where it is written (see `Placement`), and `printing` that it becomes a print.
    """

    method: MethodSettings = field(default_factory=Hierarchical)
    grid: int | None = _most_used(
        None,
        "Cells along the longest side, 16 to 4096, or auto: what the scan resolves, as far as "
        "memory allows.  [default: auto]",
        low=MIN_GRID, high=MAX_GRID, kind=GridSize(), metavar="N",
    )  # fmt: skip
    viewpoint: Viewpoint = _most_used(
        (),
        "Where the points were measured from: above, below, inside, outside, or the scanner's "
        "place as X,Y,Z in the coordinates of the input, or a file of a trajectory (.csv, .txt) or "
        "of cameras (COLMAP, OpenDroneMap, Metashape and others); places and files may be given "
        "several times.",
        kind=FILE_OR_WORD, multiple=True, metavar="WHERE", parse=parse_viewpoint,
    )  # fmt: skip
    attributes: AttributeChoice = _most_used(
        AttributeChoice(),
        "What the vertices carry: auto (colours and all other columns of the points), none, or "
        "names as a,b,c; normals, support and confidence are made where they are named.",
        kind=click.STRING, typed="auto", metavar="NAMES", parse=parse_attributes,
    )  # fmt: skip
    faces: int | None = _most_used(None, "Simplify the mesh to N triangles.", low=4)
    max_memory: float | None = _most_used(
        None,
        "Most memory of all processes of a machine, as 2G; larger clouds stay on disk.",
        kind=click.STRING, metavar="SIZE", parse=_parse_limit,
    )  # fmt: skip
    cluster: Path | None = _most_used(
        None,
        "Run on a cluster: by its cluster file (.yaml), or on its head by its inventory (.json).",
        kind=InputFile(), metavar="FILE",
    )  # fmt: skip
    normals: str = _of_points(
        "auto",
        "Estimate normals where there are none and mend those that contradict each other, take "
        "those of the file as they are, or estimate all.",
        choices=("auto", "file", "estimate"),
    )
    align: bool = _of_points(
        False, "The files are scans in frames of their own: align them first, as 'hpcapp align'."
    )
    outliers: bool = _of_points(False, "Remove statistical outliers first.")
    denoise: bool = _of_points(False, "Project the points by moving least squares first.")
    resample: bool = _of_points(False, "Resample the points to even density first.")
    voxel_size: float | None = _of_surface(
        None,
        "Edge of a cell, in the units of the input.",
        low=0, is_open=True, metavar="S", replaces=("grid", "depth"),
    )  # fmt: skip
    depth: int | None = _of_surface(
        None, "The same as --grid 2^D.", low=4, high=12, metavar="D", replaces=("grid",)
    )
    tolerance: float | None = _of_surface(
        None,
        "Simplify the mesh while its surface moves by less, in the units of the input.",
        low=0, is_open=True, metavar="LENGTH",
    )  # fmt: skip
    texture: int | None = _of_surface(
        None,
        "With --faces: bake the colours of all points and the normals of the mesh as it was into a "
        "picture of so many pixels a side, in a .glb or beside an .obj.",
        low=LEAST_PIXELS, high=MOST_PIXELS, metavar="PIXELS",
    )  # fmt: skip
    images: tuple[Photo, ...] | None = _of_surface(
        None,
        "With --texture: take the colours from the photographs in a folder, whose cameras "
        "--viewpoint names.",
        kind=FILE_OR_WORD, metavar="FOLDER",
    )  # fmt: skip
    pieces: int | None = None
    smallest: float | None = None
    origin: str | tuple[float, float, float] = "auto"
    up: str | None = None
    backend: str = _of_place(
        "auto",
        "Where batches run: auto (where it should be fastest), serial, threads, processes, zmq, "
        "dask=ADDRESS, ray[=ADDRESS], mpi, or MODULE:FUNCTION that makes an Executor.",
        metavar="NAME",
    )
    workers: int | None = _of_place(
        None,
        "How many workers; with --backend auto at most so many, as many as pay.",
        low=1, high=1024, metavar="W",
    )  # fmt: skip
    policy: str = _of_place(
        DEFAULT_POLICY,
        "Batches by each worker's speed, to whoever is free, or the paper's equal batches.",
        choices=tuple(POLICIES),
    )
    verify: float | None = _of_place(
        None,
        "Have this share of the tasks run again on another machine, and turn away who gives wrong "
        "answers.  [default: 0.02 with --cluster and three workers or more, else 0]",
        low=0.0, high=1.0, metavar="SHARE",
    )  # fmt: skip
    temp_dir: str | None = _of_place(
        None,
        "Where points and finished tiles lie meanwhile: a folder, or s3://BUCKET/PREFIX.",
        kind=STORAGE, metavar="PLACE",
    )  # fmt: skip
    resume: bool = _of_place(
        False,
        "Go on from what a job that was killed has left in --temp-dir, and leave there what is "
        "finished if this one fails.",
        words=("--resume",),
    )
    update: str | None = _of_place(
        None,
        "Take the tiles whose points are as they were from where a job of other scans has left "
        "them, and leave this one's there: a folder, or s3://BUCKET/PREFIX.",
        kind=STORAGE, metavar="PLACE", replaces=("temp_dir",),
    )  # fmt: skip
    crop: Crop = field(default_factory=Crop)
    printing: Printing | None = None

    def __post_init__(self) -> None:
        check_options(self)
        if (self.pieces, self.smallest) != (None, None):
            self.piece_choice.check()

    def for_ground(self) -> Self:
        """Return the same; where bare ground is asked for it is seen from above, and open.

        What else has been asked for stays.
        """
        if not self.crop.ground:
            return self
        method = self.method
        if isinstance(method, Hierarchical) and method.close == "auto":
            method = replace(method, close="no")
        return replace(self, method=method, viewpoint=self.viewpoint or "above")

    def for_reading(self, reading: Reading) -> Self:
        """Return the same; a print is closed, but of what goes on beyond the scan.

        What else has been asked for stays.
        """
        method = self.method
        is_free = isinstance(method, Hierarchical) and method.close == "auto"
        if self.printing is None or not is_free or reading.share_going_on > 0.5:
            return self
        return replace(self, method=replace(method, close="yes"))

    @property
    def room(self) -> str | None:
        """The place that was named for points and tiles, if any."""
        return self.temp_dir if self.update is None else self.update

    @property
    def target(self) -> Target:
        """How light the mesh shall be."""
        return Target(self.faces, self.tolerance)

    @property
    def piece_choice(self) -> PieceChoice:
        """Which pieces of the mesh shall stay."""
        from hpcapp.geometry.pieces import PieceChoice

        return PieceChoice(self.pieces, self.smallest)

    @property
    def placement(self) -> Placement:
        """Where the mesh shall be written, and which way up."""
        from hpcapp.io.placement import Placement

        return Placement(self.origin, self.up)


@dataclass(frozen=True, slots=True)
class JobSettings(Settings):
    """What a user asks of a reconstruction from file to file.

    Where `points` is made of them, `inputs` are the files that the user named; `command` is what
    was typed, to be typed again.
    """

    points: Path
    output: str = _most_used(
        MISSING,
        "Mesh to write: .ply, .obj, .glb, .vtp, .3mf, .off, .stl, or a folder: of PLYs, .tiles, or "
        "for web viewers, .3dtiles; - writes a PLY to standard output.",
        words=("-o", "--output"), kind=MESH, metavar="MESH",
    )  # fmt: skip
    inputs: tuple[Path, ...] = ()
    report: Path | None = _most_used(
        None,
        "Write a page (.html) with the mesh and all that the job decided and did; works offline.",
        kind=PAGE, metavar="PAGE",
    )  # fmt: skip
    png: Path | None = _most_used(
        None, "Draw the mesh into a picture.", kind=PICTURE, metavar="FILE"
    )
    command: tuple[str, ...] = ()
    size: int | None = _of_surface(
        None,
        "Simplify the mesh to a file of at most that: 20MB.",
        kind=click.STRING, metavar="BYTES",
    )  # fmt: skip
    details: bool = option(
        False,
        "With --json: also when each task ran and which tile and worker made each vertex, for "
        "'hpcapp view --report'.",
        group="Watching and reporting", words=("--details",),
    )  # fmt: skip

    @property
    def files(self) -> tuple[Path, ...]:
        """What the points come from."""
        return self.inputs or (self.points,)

    @property
    def shown(self) -> str:
        """The input for messages."""
        first, *more = map(str, self.files)
        return f"{first} and {len(more)} more" if more else first


def choose_steps(settings: Settings) -> tuple[tuple[str, Preprocess], ...]:
    """Return the preprocessing steps that are switched on, in the paper's order.

    Of each there is the name, and what it does to a cloud in memory.
    """
    if not (settings.outliers or settings.denoise or settings.resample):
        return ()  # what the steps stand on is heavy
    from hpcapp.applications.surface.paper.preprocess import denoise, remove_outliers, resample

    wanted: tuple[tuple[bool, str, Preprocess], ...] = (
        (settings.outliers, "remove outliers", remove_outliers),
        (settings.denoise, "denoise", denoise),
        (settings.resample, "resample", resample),
    )
    return tuple((name, step) for is_wanted, name, step in wanted if is_wanted)


def choose_local(settings: Settings, points: int) -> tuple[str, int]:
    """Return the backend here that pays for so many points, and its workers, as far as allowed."""
    threads = min(settings.workers or available_cores(), available_cores())
    if points < THREADS_FROM_POINTS or threads == 1:
        return "serial", 1
    return "threads", threads


def count_own_threads(settings: Settings, points: int) -> int:
    """Return how many threads pay for so many points in memory before a backend is open."""
    return 1 if settings.backend == "serial" else choose_local(settings, points)[1]


def name_backend(settings: Settings) -> str | None:
    """Return the backend that the user names; None where it is to be chosen.

    With ``zmq`` and a cluster it is the path of the cluster's inventory.
    """
    if settings.cluster is not None and settings.backend == "zmq":
        return str(settings.cluster)
    return None if settings.backend == "auto" else settings.backend


def choose_threads(workforce: Workforce, points: int) -> int:
    """Return how many threads pay for so many points in this process."""
    if points < THREADS_FROM_POINTS:
        return 1
    return workforce.workers if workforce.in_process else available_cores()
