"""What a job's mesh carries: looked up among the points, wherever these are."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from hpcapp.applications.surface.attributes.carrying import Carrying
from hpcapp.applications.surface.attributes.choice import CONFIDENCE
from hpcapp.applications.surface.job.plan import choose_tile
from hpcapp.applications.surface.job.scan import Loaded
from hpcapp.applications.surface.job.settings import Settings, choose_threads
from hpcapp.progress import StageClock
from hpccomponent.cli.option_names import name_option

if TYPE_CHECKING:
    from hpcapp.applications.surface.job.outcome import Outcome


log = logging.getLogger("hpcapp")

_MOST_AT_ONCE = 1 << 20  # points; more bring nothing


def carry_columns(
    settings: Settings, loaded: Loaded, outcome: Outcome, clock: StageClock
) -> Carrying:
    """Return what the vertices of a job's mesh carry."""
    cloud, choice = loaded.cloud, settings.attributes
    layout = loaded.columns.with_found(cloud)
    placement = settings.placement.with_up(loaded.reading.up)
    if choice.has_confidence and CONFIDENCE not in layout.attributes:
        reason = "the normals are those of the input as they are"
        log.warning("warning: %s: left out: %s", name_option("attributes", CONFIDENCE), reason)
    if layout.colours is None and not layout.attributes and not choice.has_support:
        return Carrying(layout, None, None, choice.has_normals, loaded.crs, placement)
    tile = choose_tile(settings, outcome.backend, cloud)
    at_once = min(tile or _MOST_AT_ONCE, _MOST_AT_ONCE)
    threads = choose_threads(outcome.backend.workforce, len(cloud))
    with clock.stage("attributes"):
        spacing = float(outcome.result.facts.get("spacing", 0.0))
        if not spacing and choice.has_support:
            spacing = cloud.measured.spacing
        evaluate = loaded.columns.open(cloud, spacing, threads, at_once)
    support = spacing if choice.has_support else None
    return Carrying(layout, evaluate, support, choice.has_normals, loaded.crs, placement)
