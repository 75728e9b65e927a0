"""How far a mesh is simplified."""

from __future__ import annotations

from math import inf

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError


@dataclass(frozen=True, slots=True)
class Target:
    """When to stop: at whichever comes first.

    There are no fewer faces than that, but for one; the tolerance is how far the surface may move,
    in length units of the mesh.
    """

    faces: int | None = None
    tolerance: float | None = None

    @property
    def is_something(self) -> bool:
        """Whether anything is asked for."""
        return self.faces is not None or self.tolerance is not None

    def check(self) -> None:
        """Find out before the work whether it can be done.

        Raise UsageError where a number is out of its range.
        """
        if self.faces is not None and not self.faces >= 4:
            raise UsageError(f"faces is {self.faces!r}", "give 4 or more")
        if self.tolerance is not None and not 0.0 < self.tolerance < inf:
            raise UsageError(f"tolerance is {self.tolerance!r}", "give a length greater than zero")
