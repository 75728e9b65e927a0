"""What a user chooses of the default method, and what it needs; nothing heavy is imported."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from hpcapp.applications.surface.boundary.lengths import parse_length
from hpcapp.applications.surface.methods.method import (
    BYTES_OF_PROGRAM,
    BYTES_PER_POINT,
    BYTES_PER_SURFACE_CELL,
)
from hpcapp.applications.surface.methods.options import check_options, option
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError

if TYPE_CHECKING:
    from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
    from hpcapp.applications.surface.methods.method import Method, Resolution, Resources


@dataclass(frozen=True, slots=True)
class Hierarchical:
    """Hierarchical Hermite quadrics, blended by a partition of unity.

    UsageError where a factor is beyond its range, or a length is none.

    Parameters
    ----------
    smoothness : float
        Factor on the noise that is estimated, 0.1 to 10: above 1 the mesh is smoother.
    detail : float
        Factor on the resolution that the spacing allows, 0.1 to 10: above 1 there is more detail
        and less averaging.
    clean : bool
        Whether to drop outliers and to flip normals that their neighbours contradict.
    close : str
        ``yes`` for a watertight mesh, ``no`` for one that is open where no point supports it,
        ``auto`` for one that is open where the points are plainly a view, a terrain or a room.
    trim : str
        Half the width of the gaps between points that an open mesh bridges; its border ends about
        half as far from the points: in units of the input, as ``0.05``, in spacings, as ``3s``, or
        ``auto``. A length asks for an open mesh.
    fill_holes : str
        Holes of an open mesh that are no larger than this are filled; likewise.
    uniform : bool
        Whether the grid has one step, however uneven the points lie.
    """

    smoothness: float = option(
        1.0, "Factor on the smoothing that the noise asks for.", low=0.1, high=10, group="Surface"
    )
    detail: float = option(
        1.0,
        "Factor on the finest detail that the spacing allows.",
        low=0.1,
        high=10,
        group="Surface",
    )
    clean: bool = option(True, "Drop outliers and flip inconsistent normals first.", group="Points")
    close: str = option(
        "auto",
        "Watertight (yes), open where no point supports the surface (no), or open only where the "
        "points are plainly a view, a terrain or a room.",
        choices=("auto", "yes", "no"),
        group="Most used",
    )
    trim: str = option(
        "auto",
        "Open, with gaps up to twice as wide bridged: a length, or spacings as 2s.",
        group="Surface",
    )
    fill_holes: str = option(
        "auto",
        "Holes of an open mesh up to this size are filled: a length, or spacings as 10s.",
        group="Surface",
    )
    uniform: bool = option(
        False,
        "One step for the whole grid; without it, cells are larger where points are sparse.",
        group="Surface",
    )

    name: ClassVar[str] = "hierarchical"
    summary: ClassVar[str] = "Hermite quadrics on a pyramid"
    needs_whole_cloud: ClassVar[bool] = False
    pays_on_workers: ClassVar[bool] = True
    makes_closed_meshes: ClassVar[bool] = True
    memory_power: ClassVar[int] = 2

    def __post_init__(self) -> None:
        check_options(self)
        for name in ("trim", "fill_holes"):
            parse_length(name, getattr(self, name))
        if self.close == "yes" and (self.trim, self.fill_holes) != ("auto", "auto"):
            raise UsageError(
                f"{name_option('trim')} and {name_option('fill_holes')} need an open mesh",
                f"leave them out, or say {name_option('close', 'no')}",
            )

    @property
    def cleans(self) -> bool:
        """See `clean`."""
        return self.clean

    def estimate_memory(self, grid: int, points: int, cells: float) -> float:
        """Return what the points and the bricks along their surface take, in bytes."""
        del grid
        return BYTES_OF_PROGRAM + BYTES_PER_POINT * points + BYTES_PER_SURFACE_CELL * cells

    def suggest_grid(self, cloud: ArrangedCloud) -> Resolution:
        """Return the grid that shows what the scan resolves."""
        from hpcapp.applications.surface.resolution.estimates import suggest_grid

        longest = float((cloud.high - cloud.low).max())
        return suggest_grid(cloud.measured, longest, self.smoothness, self.detail)

    def open(self, grid: int, resources: Resources) -> Method[Any, Any]:
        """Return the strategy."""
        from hpcapp.applications.surface.boundary.drive import OpeningSettings
        from hpcapp.applications.surface.hierarchical.method import HierarchicalMethod

        return HierarchicalMethod(
            grid,
            self.smoothness,
            self.detail,
            resources.threads,
            resources.tile_points,
            resources.checkpoint,
            resources.show_part,
            OpeningSettings(
                self.close,
                parse_length("trim", self.trim),
                parse_length("fill_holes", self.fill_holes),
            ),
            self.uniform,
        )
