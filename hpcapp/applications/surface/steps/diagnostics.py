"""Sanity checks that warn about suspicious reconstructions.

Each function returns sentences that say what is odd and what to do, or none.
"""

from __future__ import annotations

import logging
from typing import Any

from hpcapp import kernels
from hpcapp.applications.surface.boundary.closing import SURE
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.job.outcome import Reconstruction
from hpcapp.applications.surface.job.scan import Loaded
from hpcapp.applications.surface.job.settings import Settings
from hpcapp.applications.surface.stitching.surface import Surface
from hpcapp.applications.surface.types.reading import AMONG, Reading
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.wording import say_count
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass

log = logging.getLogger("hpcapp")

#: Points are judged on a sample of about so many.
SAMPLE = 10_000
#: Share of the vertices outside the points' box; a closed scan leaves it by less than a cell.
OUTSIDE = 0.02
#: Share of a closed mesh without points that is worth a word; objects from all sides have .1.
GUESSED = 0.2


def check_sides(reading: Reading) -> list[str]:
    """Warn of normals of a file that face inwards.

    A cloud of the inside of a room is oriented like one of an object turned inside out; only its
    user can tell them apart.
    """
    may_be = reading.kind, *(rival.kind for rival in reading.rivals)
    if reading.kind not in AMONG or "inside" not in may_be:
        return []
    return [
        "the normals face inwards, as of a room seen from inside: if it is an object, "
        f"{name_option('normals', 'estimate')} finds their side"
    ]


def check_resolution(cloud: PointCloud, step: float) -> list[str]:
    """Warn of a grid that has but a few cells for the whole cloud, as a far outlier causes it.

    Positions are finite; `step` is the edge of a cell.
    """
    low, high = bound_points(cloud.positions)
    along = float((high - low).max()) / step
    few = cloud.positions[:: -(-len(cloud) // SAMPLE)]  # in most clouds they tell enough
    if kernels.count_boxes(few, low, step, 1)[1] >= 2.0 * along:
        return []
    _, cells = kernels.count_boxes(cloud.positions, low, step, 1)
    if cells >= 2.0 * along or cells > len(cloud) // 4:
        return []
    return [
        f"the {len(cloud):,} points lie in only {cells:,} cells of the grid, too few to show a "
        f"shape: remove far outliers ({name_option('outliers')}), or choose a finer grid"
    ]


def check_closure(low: FloatArray, high: FloatArray, surface: Surface, step: float) -> list[str]:
    """Warn of a mesh that leaves the box of its points: it is closed where nothing was scanned.

    `low` and `high` (3,) are corners of the box around all points, in the frame of the surface,
    which has vertices; `step` is the edge of a cell.
    """
    share = surface.share_outside(low - 2.0 * step, high + 2.0 * step)
    if share <= OUTSIDE:
        return []
    return [
        f"{100.0 * share:.0f} % of the mesh lies outside the points' bounding box: the scan is "
        "open, or its normals point inwards; the mesh is closed there by guesswork"
    ]


def check_handles(facts: dict[str, Any], line_gap: float) -> list[str]:
    """Warn of handles of a closed mesh that are too small to have been scanned, and were not cut.

    What is missing in `facts` was not looked at; `line_gap` is the distance of scan lines, 0 where
    there are none.
    """
    left = facts.get("handles_left", 0)
    if not left:
        return []
    place = ", ".join(f"{value:.6g}" for value in facts["handle_place"])
    cause = (
        f"the scan lines, some {line_gap:.3g} apart, are too far apart for the relief between "
        "them: scan more of them there"
        if line_gap
        else "noise, thin walls or relief finer than the points make them: scan closer there, or "
        f"smooth more ({name_option('smoothness')})"
    )
    width = facts["handle_width"]
    return [f"{say_count(left, 'handle')} no wider than {width:.3g}, one at ({place}): {cause}"]


def check_support(facts: dict[str, Any]) -> list[str]:
    """Warn of a mesh that is closed over a wide side that was not scanned.

    What is missing in `facts` was not measured.
    """
    support = facts.get("support")
    if support is None or 1.0 - support["share"] <= GUESSED:
        return []
    return [
        f"{100.0 * (1.0 - support['share']):.0f} % of the mesh is supported by no point, up to "
        f"{support['farthest']:.3g} from the nearest one: a side that was not scanned is closed "
        f"there by guesswork; {name_option('close', 'no')} leaves it open"
    ]


def check_closing(facts: dict[str, Any]) -> list[str]:
    """Warn of a mesh that is open, or closed, and may as well be the other."""
    certainty = facts.get("closure_certainty", 1.0)
    if certainty >= SURE:
        return []
    taken, other, option = ("open", "closed", "yes") if facts["open"] else ("closed", "open", "no")
    kept = name_option("close", "no" if facts["open"] else "yes")
    return [
        f"it is {100.0 * certainty:.0f} % sure that what was scanned is {taken}: "
        f"{name_option('close', option)} makes it {other}, {kept} keeps it {taken}"
    ]


@dataclass(frozen=True, slots=True, eq=False)
class PointChecks:
    """What is suspicious of the points, and what their mesh is judged by."""

    resolution: list[str]
    low: FloatArray
    high: FloatArray
    step: float


def check_points(grid: int, cloud: ArrangedCloud) -> PointChecks:
    """Look for what is suspicious of the points of a grid."""
    low, high, points = cloud.low, cloud.high, cloud.sample(SAMPLE)
    step = float((high - low).max()) / grid
    return PointChecks(check_resolution(points, step), low, high, step)


def warn_of(
    settings: Settings, loaded: Loaded, checks: PointChecks, result: Reconstruction
) -> list[str]:
    """Log what should make the user doubt the mesh, and return it for the report."""
    warnings = [*checks.resolution]
    is_open = result.facts.get("open", False)
    # Where sides were looked for, that has been judged.
    if loaded.oriented.is_believed and not checks.resolution:
        warnings += check_sides(loaded.reading)
    # Too few cells explain a mesh that is too large.
    if not (is_open or checks.resolution) and settings.method.makes_closed_meshes:
        warnings += check_closure(checks.low, checks.high, result.surface, checks.step)
        warnings += check_handles(result.facts, loaded.cleaned.line_gap)
        warnings += check_support(result.facts)
    warnings += check_closing(result.facts)
    for warning in warnings:
        log.warning("warning: %s", warning)
    return warnings
