"""The master process of surface reconstruction: the paper's Figure 1, one stage after the other.

::

    read ─> preprocess ─> partition ─> fit ─> extract ─> write ─> check
                          │            │       └─ hierarchical: tiles to the workers, parts back
                          │            └─ paper: batches to the workers, quadrics back
                          └─ patches (paper) or tiles (hierarchical)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.cloud.measure import replace_points
from hpcapp.applications.surface.method import Method
from hpcapp.applications.surface.surface import Surface
from hpcapp.geometry.points import PointCloud
from hpcapp.progress import StageClock
from hpcapp.workforce import Workforce
from hpccomponent.errors import UsageError
from hpccomponent.option_names import name_option

Preprocess = Callable[[PointCloud], PointCloud]


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """A surface, and how it came about.

    Parameters
    ----------
    surface : Surface
        The 0-level iso-surface.
    points : int
        Points that were left after preprocessing.
    facts : dict
        What the method chose and found; ``patches`` is always there.
    """

    surface: Surface
    points: int
    facts: dict[str, Any]


def reconstruct(
    cloud: ArrangedCloud,
    method: Method[Any, Any],
    workforce: Workforce,
    clock: StageClock,
    preprocess: tuple[tuple[str, Preprocess], ...] = (),
    background: Callable[[], object] | None = None,
) -> Reconstruction:
    """Turn oriented points into a mesh.

    Parameters
    ----------
    cloud : ArrangedCloud
        Finite positions and unit normals (see `hpcapp.io.drop_unusable`).
    method : Method
        The strategy: `PaperMethod` or `HierarchicalMethod`.
    workforce : Workforce
        Where batches and tiles run.
    clock : StageClock
        Times and announces the stages.
    preprocess : tuple of (str, callable)
        Named steps that run first, in order, on clouds in memory.
    background : callable, optional
        Left for `Workforce.defer` once the cloud is cut: short passes before would wait for it.

    Raises
    ------
    HpcError
        What a stage raised.
    """
    for name, step in preprocess:
        refusal = UsageError(
            f"the step '{name}' needs all points in memory",
            f"leave it out, or give more {name_option('max_memory')}",
        )
        with clock.stage(name):
            cloud = replace_points(cloud, step(cloud.take_all(0, refusal)))
    with clock.stage("partition"):
        partition = method.partition(cloud, workforce)
    if background is not None:
        workforce.defer(background)
    with clock.stage("fit"):
        quadrics = method.fit(partition, workforce, clock.progress.advance)
    with clock.stage("extract"):
        surface = method.extract(partition, quadrics, workforce, clock.progress.advance)
    return Reconstruction(surface, len(cloud), method.facts(partition))
