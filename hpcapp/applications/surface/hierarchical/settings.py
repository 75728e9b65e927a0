"""What a user chooses of the default method, and what it needs; nothing heavy is imported."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from hpcapp.applications.surface.options import check_options, option

if TYPE_CHECKING:
    from hpcapp.applications.surface.method import Method, Resources
    from hpccomponent.surface.types.points import PointCloud

__all__ = ["Hierarchical"]


@dataclass(frozen=True, slots=True)
class Hierarchical:
    """Hierarchical Hermite quadrics, blended by a partition of unity.

    Parameters
    ----------
    smoothness : float
        Factor on the noise that is estimated, 0.1 to 10: above 1 the mesh is smoother.
    detail : float
        Factor on the resolution that the spacing allows, 0.1 to 10: above 1 there is more detail
        and less averaging.
    clean : bool
        Whether to drop outliers and to flip normals that their neighbours contradict.

    Raises
    ------
    UsageError
        A factor is beyond its range.
    """

    smoothness: float = option(
        1.0, "Factor on the smoothing that the noise asks for.", low=0.1, high=10
    )
    detail: float = option(
        1.0, "Factor on the finest detail that the spacing allows.", low=0.1, high=10
    )
    clean: bool = option(True, "Drop outliers and flip inconsistent normals first.")

    name: ClassVar[str] = "hierarchical"
    summary: ClassVar[str] = "Hermite quadrics on a pyramid"
    needs_whole_cloud: ClassVar[bool] = False
    pays_on_workers: ClassVar[bool] = True
    makes_closed_meshes: ClassVar[bool] = True
    memory_power: ClassVar[int] = 2

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def cleans(self) -> bool:
        """See `clean`."""
        return self.clean

    def estimate_memory(self, grid: int, cloud: PointCloud) -> float:
        """Return what the points and the bricks along their surface take, in bytes.

        Parameters
        ----------
        grid : int
            Cells along the longest side.
        cloud : PointCloud

        Returns
        -------
        float
        """
        from hpcapp.applications.surface.memory import estimate_surface

        return estimate_surface(grid, cloud)

    def open(self, grid: int, resources: Resources) -> Method[Any, Any]:
        """Return the strategy.

        Parameters
        ----------
        grid : int
            Cells along the longest side.
        resources : Resources

        Returns
        -------
        HierarchicalMethod

        Raises
        ------
        UsageError
            The grid is too small.
        """
        from hpcapp.applications.surface.hierarchical.method import HierarchicalMethod

        return HierarchicalMethod(
            grid,
            self.smoothness,
            self.detail,
            resources.threads,
            resources.tile_points,
            resources.keeping,
            resources.show_part,
        )
