"""The seam between the pipeline and a method of reconstruction."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

from hpcapp.applications.surface.surface import Surface
from hpcapp.batches import Workforce

__all__ = ["Advance", "Method"]

Advance = Callable[[int, int], None]
PartitionT = TypeVar("PartitionT")
QuadricsT = TypeVar("QuadricsT")


class Method(Protocol[PartitionT, QuadricsT]):
    """One way to turn oriented points into a mesh, in three stages."""

    name: str

    def partition(self, cloud: Any, workforce: Workforce) -> PartitionT:
        """Cut the cloud into the parts that are fitted one by one; one method takes any kind."""
        ...

    def fit(self, partition: PartitionT, workforce: Workforce, advance: Advance) -> QuadricsT:
        """Fit one quadric to each part, on the workers."""
        ...

    def extract(
        self, partition: PartitionT, quadrics: QuadricsT, workforce: Workforce, advance: Advance
    ) -> Surface:
        """Blend the quadrics and extract the 0-level iso-surface."""
        ...

    def facts(self, partition: PartitionT) -> dict[str, Any]:
        """Return what was chosen or found by the way, for the job's report: JSON values.

        The key ``patches`` (how many quadrics are fitted) is always there.
        """
        ...
