"""A lighter mesh: of as many faces as are asked for, or of a file of a size."""

from __future__ import annotations

import logging
from collections.abc import Collection
from dataclasses import replace

from hpcapp.applications.surface.attributes.carrying import Carrying
from hpcapp.applications.surface.job.outcome import Outcome, Reconstruction
from hpcapp.applications.surface.stitching.surface import Surface, simplify_surface
from hpcapp.progress import StageClock
from hpcapp.simplification.size import fit_size, leave_unread, weigh_mesh
from hpcapp.simplification.target import Target
from hpccomponent.files.held_folders import temporary_folder

log = logging.getLogger("hpcapp")


def simplify(
    target: Target, result: Reconstruction, clock: StageClock
) -> tuple[Reconstruction, list[str]]:
    """Simplify a surface to what is asked for, and return what to warn of."""
    if not target.is_something:
        return result, []
    with clock.stage("simplify"):
        light = simplify_surface(result.surface, target)
    warnings = []
    is_bound = target.faces is not None and target.tolerance is None
    faces = light.stream().face_count
    if is_bound and faces > (target.faces or 0):
        warnings = [f"{faces:,} faces are left: fewer would break the mesh"]
        log.warning("warning: %s", warnings[0])
    return replace(result, surface=light), warnings


def fit_surface(
    outcome: Outcome, size: int, suffix: str, carrying: Carrying, named: Collection[str]
) -> tuple[Outcome, Carrying]:
    """Return an outcome whose surface is simplified to a file of a size at most.

    Return, too, what it carries: attributes that are `named` stay.
    """
    surface = outcome.result.surface
    most = surface.stream().face_count
    with temporary_folder() as folder:
        path = folder / f"mesh{suffix}"

        def simplify(faces: int) -> Surface:
            return surface if faces == most else simplify_surface(surface, Target(faces))

        def weigh(faces: int) -> int:
            with simplify(faces).open_stream() as stream:
                return weigh_mesh(path, carrying.to_stream(stream), carrying.placement)

        attributes = carrying.columns.attributes
        stays = leave_unread(attributes, suffix, named, most, size, weigh)
        carrying = carrying.with_attributes(stays)
        light = simplify(fit_size(size, most, weigh))
    return replace(outcome, result=replace(outcome.result, surface=light)), carrying
