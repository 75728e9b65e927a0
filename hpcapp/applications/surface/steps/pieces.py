"""The pieces of a surface that are asked for; where nobody asks, the small ones are named."""

from __future__ import annotations

import logging
from dataclasses import replace

from hpcapp.applications.surface.job.outcome import Reconstruction
from hpcapp.geometry.pieces import PieceChoice, find_small, say_dropped, say_small
from hpcapp.progress import StageClock

log = logging.getLogger("hpcapp")


def keep_pieces(choice: PieceChoice, result: Reconstruction, clock: StageClock) -> Reconstruction:
    """Drop pieces that are not asked for; UsageError where none is as large as was asked for."""
    surface = result.surface
    if not choice.is_something:
        areas = surface.plan.pieces()[1]
        is_small = find_small(areas)
        if is_small.any():
            log.info("%s", say_small(areas, is_small))
        return replace(result, facts=result.facts | {"small_pieces": int(is_small.sum())})
    with clock.stage("keep pieces"):
        components, areas = surface.plan.pieces()
        stays = choice.choose(areas)
        surface = surface.only(components[stays])
    log.info("%s", say_dropped(areas, stays))
    facts = result.facts | {"pieces_dropped": int((~stays).sum())}
    return replace(result, surface=surface, facts=facts)
