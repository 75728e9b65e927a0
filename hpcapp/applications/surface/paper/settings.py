"""What a user chooses of the paper's method, and what it needs; nothing heavy is imported."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from hpcapp.applications.surface.methods.method import MARGIN, Resolution
from hpcapp.applications.surface.methods.options import check_options, option
from hpccomponent.dataclass import dataclass

if TYPE_CHECKING:
    from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
    from hpcapp.applications.surface.methods.method import Method, Resources
    from hpcapp.applications.surface.paper.method import PaperPartition
    from hpcapp.geometry.points import FloatArray


_GRID = 256
_BYTES_PER_NODE = 16.0
"""Values, their magnitudes, masks, and a median's copy of every node of a cube."""


@dataclass(frozen=True, slots=True)
class Paper:
    """The paper's algorithm: one quadric for each leaf of a kd-tree, blended by their boxes.

    UsageError where a value is beyond its range, or `patches` beside what it takes the place of.

    Parameters
    ----------
    delta : float
        Threshold of the normal cone, in [-1, 1].
    max_points : int, optional
        The most points of a patch.
    cone : {"paper", "complement"}
        Whether normals agree where n.m > delta, as printed, or where n.m > 1 - delta.
    patches : int, optional
        Split the fullest box until there are so many; takes the place of the three above.
    norm : {"consistent", "printed"}
        Whether the columns of D have the factor sqrt(2), or stand as printed.
    """

    delta: float = option(0.1, "The normal cone's condition.", low=-1, high=1)
    max_points: int | None = option(None, "Most points of a patch.  [default: no limit]", low=1)
    cone: str = option(
        "paper",
        "n.m > delta as printed, or n.m > 1 - delta.",
        choices=("paper", "complement"),
    )
    patches: int | None = option(
        None,
        "Split the fullest box until there are N patches, in place of the cone.",
        low=1,
        replaces=("delta", "cone", "max_points"),
    )
    norm: str = option(
        "consistent",
        "Columns of D with the factor sqrt(2), or as printed.",
        choices=("consistent", "printed"),
    )

    name: ClassVar[str] = "paper"
    summary: ClassVar[str] = "the paper's algorithm"
    needs_whole_cloud: ClassVar[bool] = True
    pays_on_workers: ClassVar[bool] = False
    makes_closed_meshes: ClassVar[bool] = False
    memory_power: ClassVar[int] = 3

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def cleans(self) -> bool:
        """The paper has its own steps for that, which are asked for one by one."""
        return False

    def estimate_memory(self, grid: int, points: int, cells: float) -> float:
        """Return what the nodes of the grid take, in bytes."""
        del points, cells
        return _BYTES_PER_NODE * float(grid) ** 3

    def suggest_grid(self, cloud: ArrangedCloud) -> Resolution:
        """Return a grid of 256, whose nodes a small machine holds."""
        del cloud
        return Resolution(_GRID, "the default of this method")

    def open(self, grid: int, resources: Resources) -> Method[PaperPartition, FloatArray]:
        """Return the strategy, whose own grid has no margins."""
        from hpcapp.applications.surface.paper.method import PaperMethod

        return PaperMethod(
            delta=self.delta,
            max_points=self.max_points,
            cone=self.cone,
            patches=self.patches,
            norm=self.norm,
            grid=grid - 2 * MARGIN,
            show_part=resources.show_part,
        )
