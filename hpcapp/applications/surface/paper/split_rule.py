"""The paper's rule for splitting a box: its normals spread too far, or it holds too many points."""

from __future__ import annotations

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError


@dataclass(frozen=True, slots=True)
class SplitRule:
    """When a box of the tree is split; a UsageError is raised where a value is outside its range.

    It is where it holds more than `max_points`, or some normal has ``n . n_mean <= limit``,
    `n_mean` being normalised. By the `cone` "paper" the limit is `delta`, from -1 to 1, as the
    paper prints it; by "complement" 1 - delta, as its text and its Figures 2 and 4 ask; by "none"
    normals do not matter.
    """

    delta: float = 0.1
    cone: str = "paper"
    max_points: int | None = None

    def __post_init__(self) -> None:
        if not -1.0 <= self.delta <= 1.0:
            raise UsageError(f"delta is {self.delta}", "give a number from -1 to 1, such as 0.1")
        if self.cone not in ("paper", "complement", "none"):
            raise UsageError(f"cone is {self.cone!r}", "choose paper, complement or none")
        if self.max_points is not None and self.max_points < 1:
            raise UsageError(f"max_points is {self.max_points}", "give 1 or more, or leave it out")

    @property
    def limit(self) -> float:
        """The smallest cosine to the mean normal that a patch may not have."""
        return {"paper": self.delta, "complement": 1.0 - self.delta, "none": -2.0}[self.cone]
