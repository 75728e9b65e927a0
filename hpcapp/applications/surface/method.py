"""The seam between the pipeline and a method of reconstruction."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

from hpcapp.applications.surface.surface import Surface
from hpcapp.workforce import Workforce

__all__ = ["Advance", "Method"]

Advance = Callable[[int, int], None]
PartitionT = TypeVar("PartitionT")
QuadricsT = TypeVar("QuadricsT")


class Method(Protocol[PartitionT, QuadricsT]):
    """One way to turn oriented points into a mesh, in three stages."""

    name: str

    def partition(self, cloud: Any, workforce: Workforce) -> PartitionT:
        """Cut the cloud into parts; clouds that are not in memory are not for every method."""
        ...

    def fit(self, partition: PartitionT, workforce: Workforce, advance: Advance) -> QuadricsT:
        """Fit quadrics on the workers: all of them, or what the parts must know of the whole."""
        ...

    def extract(
        self, partition: PartitionT, quadrics: QuadricsT, workforce: Workforce, advance: Advance
    ) -> Surface:
        """Fit what is left, blend the quadrics and extract the 0-level iso-surface."""
        ...

    def facts(self, partition: PartitionT) -> dict[str, Any]:
        """Return what was chosen or found by the way, for the job's report: JSON values.

        The key ``patches`` (parts that the quadrics stand for) is always there.
        """
        ...
