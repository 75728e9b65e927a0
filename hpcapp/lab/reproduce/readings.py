"""How the paper's rule for splitting a box can be read, and what its step 1 changes of that."""

from __future__ import annotations

from hpcapp.applications.surface.paper.kdtree import SplitRule, TreePatches, partition_by_rule
from hpcapp.geometry.points import PointCloud
from hpccomponent.dataclass import dataclass

#: The paper's threshold on the normal cone.
DELTA = 0.1
#: Said of every figure.
STEP_1 = (
    "Step 1, to denoise and resample, is off as in `--method paper`, because only then the bunny "
    "has the 240 patches of Section V (of 35,947 points; the paper's 240 are of 263,256, of which "
    "the same rule makes 1,661 here); with it, 209"
)
#: Said of figures of any cloud but the paper's.
OTHER_CLOUD = (
    "The paper's numbers are of the Stanford bunny with 35,947 points, so those of this cloud "
    "need not be near them. "
)
_NAMES = {
    "paper": "as printed, n.m > 0.1",
    "complement": "complement, n.m > 0.9",
    "none": "points only",
}


@dataclass(frozen=True, slots=True)
class RuleReading:
    """One way to read the rule, for `SplitRule` and `partition_by_rule`."""

    cone: str
    root: str = "cube"
    max_points: int | None = None

    def cut(self, points: PointCloud) -> TreePatches:
        """Cut points with unit normals into patches."""
        assert points.normals is not None  # noqa: S101 - a subject has them
        rule = SplitRule(DELTA, self.cone, self.max_points)
        return partition_by_rule(points.positions, points.normals, rule, self.root)

    def __str__(self) -> str:
        limit = "" if self.max_points is None else f", at most {self.max_points:,} points"
        return f"{_NAMES[self.cone]}, root {self.root}{limit}"
