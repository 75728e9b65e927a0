"""What a job's mesh carries: looked up among the points, wherever these are.

Points that lie in a folder have no columns there: these are put beside them when the surface is
done, in one more pass over the input, here.
"""

from __future__ import annotations

import logging
import secrets
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hpcapp.applications.surface.attributes.carrying import Carrying
from hpcapp.applications.surface.attributes.choice import CONFIDENCE, AttributeChoice
from hpcapp.applications.surface.input.folder import choose_tile
from hpcapp.applications.surface.input.load import Loaded
from hpcapp.applications.surface.settings import JobSettings, Settings, choose_threads
from hpcapp.io import open_points
from hpcapp.progress import StageClock
from hpccomponent.files.private_files import make_private_folder
from hpccomponent.surface.cloud.spacing import estimate_spacing
from hpccomponent.surface.types.points import PointCloud

if TYPE_CHECKING:
    from hpcapp.applications.surface.job.steps import Outcome
    from hpccomponent.surface.attributes.blocks import ColumnBlocks

__all__ = ["carry_from_file", "carry_from_memory"]

log = logging.getLogger("hpcapp")

_MOST_AT_ONCE = 1 << 20  # points; more bring nothing


def carry_from_memory(
    settings: Settings, loaded: Loaded, outcome: Outcome, clock: StageClock
) -> Carrying:
    """Return what the vertices of a mesh carry whose points are in memory.

    Parameters
    ----------
    settings : Settings
    loaded : Loaded
        In memory, with the columns that are asked for.
    outcome : Outcome
    clock : StageClock

    Returns
    -------
    Carrying
    """
    points, choice = loaded.cloud.points, settings.attributes
    assert points is not None  # noqa: S101 - they are in memory
    _warn_of_confidence(loaded, choice, "the normals are those of the input as they are")
    if not _needs_points(loaded.columns, choice):
        return Carrying(loaded.columns, has_normals=choice.has_normals)
    from hpccomponent.surface.attributes.carry import AttributeField  # scipy takes its time

    with clock.stage("attributes"):
        spacing = None
        if choice.has_support:
            spacing = outcome.result.facts.get("spacing") or estimate_spacing(points.positions)
        threads = choose_threads(outcome.backend.workforce, len(points))
        field = AttributeField(points, loaded.labels, threads)
    return Carrying(loaded.columns, field.evaluate, spacing, choice.has_normals)


def carry_from_file(
    settings: JobSettings, loaded: Loaded, outcome: Outcome, clock: StageClock
) -> Carrying:
    """Return what the vertices of a job's mesh carry.

    Parameters
    ----------
    settings : JobSettings
    loaded : Loaded
        In memory with the columns that are asked for, or in a folder without any: then they are
        read from the file again, and put beside the points.
    outcome : Outcome
    clock : StageClock

    Returns
    -------
    Carrying
    """
    cloud, choice = loaded.cloud, settings.attributes
    if cloud.points is not None:
        return carry_from_memory(settings, loaded, outcome, clock)
    _warn_of_confidence(loaded, choice, "it is known only where the points are in memory")
    if not _needs_points(loaded.columns, choice):
        return Carrying(loaded.columns, has_normals=choice.has_normals)
    from hpccomponent.surface.attributes.search import evaluate_blocks

    at_once = min(choose_tile(settings, outcome.backend) or _MOST_AT_ONCE, _MOST_AT_ONCE)
    with clock.stage("attributes"):
        columns, labels = _put_columns(settings, loaded, at_once)
    spacing = float(outcome.result.facts["spacing"])
    threads = choose_threads(outcome.backend.workforce, len(cloud))
    find = partial(
        evaluate_blocks,
        cloud,
        columns.take_blocks,
        labels,
        spacing,
        threads=threads,
        points=at_once,
    )
    support = spacing if choice.has_support else None
    return Carrying(loaded.columns, find, support, choice.has_normals)


def _put_columns(
    settings: JobSettings, loaded: Loaded, at_once: int
) -> tuple[ColumnBlocks, frozenset[str]]:
    """Put the columns of a file beside its points; return which of them hold labels, too."""
    from hpccomponent.surface.attributes.blocks import ColumnBlocks
    from hpccomponent.surface.attributes.labels import LabelSearch

    cloud = loaded.cloud
    folder = Path(str(cloud.place)).parent / f"columns-{secrets.token_hex(4)}"
    make_private_folder(folder)
    columns, search = ColumnBlocks(folder, cloud, loaded.columns), LabelSearch()
    for part in open_points(settings.points).chunks(at_once):
        chosen = settings.attributes.select(part, settings.shown)
        search.add(chosen.attributes)
        local = chosen.positions - cloud.origin if cloud.origin.any() else chosen.positions
        columns.add(PointCloud(local, None, chosen.colours, chosen.attributes))
    return columns, search.labels


def _needs_points(columns: PointCloud, choice: AttributeChoice) -> bool:
    """Tell whether vertices are looked up among the points."""
    return columns.colours is not None or bool(columns.attributes) or choice.has_support


def _warn_of_confidence(loaded: Loaded, choice: AttributeChoice, reason: str) -> None:
    """Say that the confidence of the normals is asked for and not there."""
    if choice.has_confidence and CONFIDENCE not in loaded.columns.attributes:
        log.warning("warning: --attributes %s: left out: %s", CONFIDENCE, reason)
