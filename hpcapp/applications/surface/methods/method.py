"""The seam between the job and a method of reconstruction.

A method is two objects: its settings, a frozen dataclass of options that says what the method
needs, and the strategy that the settings open for one job. Whoever wants to know something of a
method asks its settings; nobody asks for its name. ``methods.py`` has the table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import Field
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar

from hpccomponent.dataclass import dataclass

if TYPE_CHECKING:
    from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
    from hpcapp.applications.surface.stitching.surface import Surface
    from hpcapp.applications.surface.tiles.checkpoint import Checkpoint
    from hpcapp.workforce import Workforce


MARGIN = 4
"""Cells of the grid that stay free on each side of the cloud."""

MIN_GRID, MAX_GRID = 16, 4096
"""Cells along the longest side that may be asked for."""

BYTES_OF_PROGRAM, BYTES_PER_POINT, BYTES_PER_SURFACE_CELL = 1e8, 150.0, 350.0
"""The default method holds the points, sorted too, and bricks along the surface; measured from
above on 36 thousand to 10 million points and grids of 256 to 1024, mesh and check included."""

TILE_POINTS = 2_500_000
"""Of a tile where nothing else asks for smaller ones: what it takes stays below a gigabyte."""
LARGE_TILE = 1_000_000
"""Points: smaller tiles cost more for their halos than is gained by handing them out freely."""
TILES_EACH = 2
"""Of a worker, where they are as large as that; one at least. Each more costs halos, and more than
`tiles.KEPT_TILES` are prepared twice."""

Advance = Callable[[int, int], None]
ShowPart = Callable[[Callable[[], Any]], None]


def show_nothing(load: Callable[[], Any]) -> None:
    """Leave a part unseen."""


PartitionT = TypeVar("PartitionT")
QuadricsT = TypeVar("QuadricsT")


@dataclass(frozen=True, slots=True, eq=False)
class Resources:
    """What a job gives its method to work with; no mesh depends on it.

    A tile has about `tile_points` at most, where memory is short, and is kept by the `checkpoint`
    when it is finished. `show_part` is told of each `MeshPart` as it comes, by what returns it.
    """

    threads: int = 1
    tile_points: int | None = None
    checkpoint: Checkpoint | None = None
    show_part: ShowPart = show_nothing


@dataclass(frozen=True, slots=True)
class Resolution:
    """The cells of the grid along the longest side, margins included, and for people why."""

    grid: int
    reason: str


class MethodSettings(Protocol):
    """The options of a method, and what it needs."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]
    name: ClassVar[str]
    summary: ClassVar[str]
    """One line, for ``--help``."""
    needs_whole_cloud: ClassVar[bool]
    """Whether all points must be in memory at once; else they may lie in blocks in a folder."""
    pays_on_workers: ClassVar[bool]
    """Whether its tasks can be worth the way to other processes."""
    makes_closed_meshes: ClassVar[bool]
    """Whether a mesh far larger than its points is a reason to warn."""
    memory_power: ClassVar[int]
    """By which power of the grid its memory grows."""

    @property
    def cleans(self) -> bool:
        """Whether outliers are dropped and inconsistent normals flipped first."""

    def estimate_memory(self, grid: int, points: int, cells: float) -> float:
        """Return the bytes that a job holds at its peak, all points in memory.

        The `grid` has so many cells along the longest side, and `cells` along the surface.
        """

    def suggest_grid(self, cloud: ArrangedCloud) -> Resolution:
        """Return the resolution that suits a cloud with normals, where the user asks for none.

        InputError where there are none, or all points are the same.
        """

    def open(self, grid: int, resources: Resources) -> Method[Any, Any]:
        """Return the strategy for one job, whose grid has so many cells, margins included.

        UsageError where options contradict each other.
        """


class Method(Protocol[PartitionT, QuadricsT]):
    """One way to turn oriented points into a mesh, in four stages.

    Each is given what the stages before it have returned, and tells `advance` (parts done, parts in
    all).
    """

    def partition(self, cloud: ArrangedCloud, workforce: Workforce) -> PartitionT:
        """Cut a cloud with unit normals into parts; InputError where it is of no surface."""

    def fit(self, partition: PartitionT, workforce: Workforce, advance: Advance) -> QuadricsT:
        """Fit quadrics on the workers: all of them, or what the parts must know of the whole."""

    def extract(
        self, partition: PartitionT, quadrics: QuadricsT, workforce: Workforce, advance: Advance
    ) -> Surface:
        """Fit what is left, blend the quadrics and extract the 0-level iso-surface."""

    def close(
        self, partition: PartitionT, surface: Surface, workforce: Workforce, advance: Advance
    ) -> Surface:
        """Close the borders of a surface, or cut it open, as the user or the points ask."""

    def facts(self, partition: PartitionT) -> dict[str, Any]:
        """Return what was chosen or found up to `close`, for the job's report: JSON values.

        The key ``patches`` (parts that the quadrics stand for) is always there.
        """
