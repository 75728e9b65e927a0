"""What a user asks of a reconstruction, and what follows from it for a cloud."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self, TypeAlias

from hpcapp.applications.points.crop import Crop
from hpcapp.applications.surface.attributes.choice import AttributeChoice
from hpcapp.applications.surface.hierarchical.settings import Hierarchical
from hpcapp.applications.surface.methods.method import MethodSettings
from hpcapp.applications.surface.normals.viewpoint import Viewpoint
from hpcapp.communicator.scheduling.policy import DEFAULT_POLICY
from hpcapp.geometry.pieces import PieceChoice
from hpcapp.io.placement import Placement
from hpcapp.simplification.target import Target
from hpcapp.workforce import Workforce
from hpccomponent.dataclass import dataclass
from hpccomponent.limits import available_cores
from hpccomponent.ranges import check_range

if TYPE_CHECKING:
    from hpcapp.geometry.points import PointCloud


Preprocess: TypeAlias = "Callable[[PointCloud], PointCloud]"

# Below this many points a second thread costs more than it brings.
THREADS_FROM_POINTS = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """What a user asks of a reconstruction; see ``hpcapp reconstruct --help`` for each.

    Parameters
    ----------
    grid, depth, voxel_size : int, int, float or None
        The resolution; at most one of the three, or none: then the method chooses it. `voxel_size`
        in length units of the input.
    backend, workers, policy : str, int or None, str
        Where batches run; with the backend ``auto``, the most workers that may be used.
    verify : float or None
        The share of the answers that another machine gives too; None for the backend's default.
    cluster : Path or None
        The inventory of a cluster, whose workers may be used; with the backend ``zmq`` they are.
    max_memory : float or None
        Of this process and of each worker, in bytes.
    temp_dir : str or None
        Where points and finished tiles lie: a folder, or a bucket (see `store.places`).
    resume : bool
        Whether to go on from what an earlier run left in `temp_dir`.
    outliers, denoise, resample : bool
        The paper's preprocessing, step by step.
    attributes : AttributeChoice
        What the mesh's vertices carry.
    normals : str
        ``auto`` estimates those that are missing and mends the others, ``file`` takes those of the
        input as they are, ``estimate`` takes none of them.
    viewpoint : str or tuple of tuple of float
        ``above``, ``below``, ``inside``, ``outside``, or the places where the sensor was, in the
        coordinates of the input; none where nobody has said.
    faces : int or None
        Triangles to simplify the mesh to.
    tolerance : float or None
        How far its surface may move then, in length units of the input.
    texture : int or None
        Pixels along a side of the picture that shows what it had before.
    pieces : int or None
        Connected pieces that stay, the largest ones.
    smallest : float or None
        Area of a piece that stays, in squared length units of the input.
    placement : Placement
        Where the mesh is written, and which way up.
    crop : Crop
        The part of the scan that is asked for.
    """

    method: MethodSettings = field(default_factory=Hierarchical)
    grid: int | None = None
    depth: int | None = None
    voxel_size: float | None = None
    backend: str = "auto"
    workers: int | None = None
    policy: str = DEFAULT_POLICY
    verify: float | None = None
    cluster: Path | None = None
    max_memory: float | None = None
    temp_dir: str | None = None
    resume: bool = False
    outliers: bool = False
    denoise: bool = False
    resample: bool = False
    attributes: AttributeChoice = field(default_factory=AttributeChoice)
    normals: str = "auto"
    viewpoint: Viewpoint = ()
    faces: int | None = None
    tolerance: float | None = None
    texture: int | None = None
    pieces: int | None = None
    smallest: float | None = None
    placement: Placement = field(default_factory=Placement)
    crop: Crop = field(default_factory=Crop)

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            if isinstance(value, float):
                check_range(one.name, value)

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

    @property
    def target(self) -> Target:
        """How light the mesh shall be."""
        return Target(self.faces, self.tolerance)

    @property
    def piece_choice(self) -> PieceChoice:
        """Which pieces of the mesh shall stay."""
        return PieceChoice(self.pieces, self.smallest)


@dataclass(frozen=True, slots=True)
class JobSettings(Settings):
    """What a user asks of a reconstruction from file to file.

    Parameters
    ----------
    output : str
        The mesh to write; ``-`` for standard output.
    inputs : tuple of Path
        The files that the user named, where `points` is made of them.
    report, png : Path or None
        The page and the picture to write beside the mesh.
    command : tuple of str
        What the user typed, to be typed again.
    size : int or None
        Bytes of the output, at most: it is simplified to fit.
    details : bool
        Whether the report tells when each task ran, and which tile each vertex is from.
    """

    points: Path
    output: str
    inputs: tuple[Path, ...] = ()
    report: Path | None = None
    png: Path | None = None
    command: tuple[str, ...] = ()
    size: int | None = None
    details: bool = False

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
