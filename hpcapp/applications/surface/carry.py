"""What a job's mesh carries: looked up among the points, wherever these are."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hpcapp.applications.surface.attributes.carrying import Carrying
from hpcapp.applications.surface.input.load import Loaded
from hpcapp.applications.surface.settings import Settings, choose_threads
from hpcapp.progress import StageClock
from hpccomponent.surface.cloud.spacing import estimate_spacing
from hpccomponent.surface.types.points import PointCloud

if TYPE_CHECKING:
    from hpcapp.applications.surface.steps import Outcome

__all__ = ["choose_carrying"]


def choose_carrying(
    settings: Settings, loaded: Loaded, outcome: Outcome, clock: StageClock
) -> Carrying:
    """Return what the vertices of a job's mesh carry.

    Parameters
    ----------
    settings : Settings
    loaded : Loaded
        With the columns that are asked for.
    outcome : Outcome
    clock : StageClock

    Returns
    -------
    Carrying
    """
    cloud, choice = loaded.cloud, settings.attributes
    assert isinstance(cloud, PointCloud)  # noqa: S101
    layout = cloud.view(slice(0))
    if layout.colours is None and not layout.attributes and not choice.has_support:
        return Carrying(layout, has_normals=choice.has_normals)
    from hpccomponent.surface.attributes.carry import AttributeField  # scipy takes its time

    with clock.stage("attributes"):
        spacing = None
        if choice.has_support:
            spacing = outcome.result.facts.get("spacing") or estimate_spacing(cloud.positions)
        threads = choose_threads(outcome.backend.workforce, len(cloud))
        field = AttributeField(cloud, loaded.labels, threads)
    return Carrying(layout, field.evaluate, spacing, choice.has_normals)
