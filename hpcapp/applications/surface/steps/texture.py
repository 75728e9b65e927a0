"""A light mesh with a texture: the look of all points, and of the surface before it was light."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from hpcapp.applications.surface.attributes.carrying import NOTHING, Carrying
from hpcapp.applications.surface.job.outcome import Outcome
from hpcapp.applications.surface.job.settings import Settings, choose_threads
from hpcapp.geometry.points import ByteArray, FloatArray
from hpcapp.io import write_mesh
from hpcapp.progress import StageClock
from hpcapp.texture.bake import Baked, FineNormals, bake
from hpcapp.texture.photos.painting import FindColours

log = logging.getLogger("hpcapp")


def write_textured(
    settings: Settings, outcome: Outcome, carrying: Carrying, target: Path, clock: StageClock
) -> Outcome:
    """Bake a texture, and write the mesh with it; the facts tell then how the texture is filled."""
    with clock.stage("texture"):
        baked = _bake(settings, outcome, carrying, clock)
    facts = outcome.result.facts
    log.info("%s", baked.describe(facts.get("spacing")))
    if baked.photos:
        others = None if carrying.layout.colours is None else "points"
        log.info("%s", baked.describe_photos(others))
    with clock.stage("write"):
        write_mesh(target, replace(baked.mesh, crs=carrying.crs), carrying.placement)
    result = replace(outcome.result, facts={**facts, "texture": baked.to_json()})
    return replace(outcome, result=result)


def _bake(settings: Settings, outcome: Outcome, carrying: Carrying, clock: StageClock) -> Baked:
    """Bake in the coordinates of the input, in which heights may have another unit."""
    assert settings.texture is not None  # noqa: S101 - or nobody would call
    assert outcome.fine is not None  # noqa: S101 - it is kept then
    shape = replace(NOTHING, has_normals=True, crs=carrying.crs)
    light = shape.to_mesh(outcome.result.surface.mesh())
    threads = choose_threads(outcome.backend.workforce, outcome.result.points)
    with outcome.fine.open_stream() as stream:
        normals = FineNormals(shape.to_stream(stream), settings.texture**2, threads)
    colours = _find_colours(carrying)
    photos = settings.images or ()
    spacing = outcome.result.facts.get("spacing")
    advance = clock.progress.advance
    return bake(light, normals, colours, settings.texture, photos, spacing, advance)


def _find_colours(carrying: Carrying) -> FindColours | None:
    """Return what finds colours of places among the points, where these have some."""
    evaluate = carrying.evaluate
    if carrying.layout.colours is None or evaluate is None:
        return None
    scales = np.array([1.0, 1.0, carrying.crs.height_scale])

    def find(places: FloatArray) -> ByteArray:
        found = evaluate(places * scales).points.colours
        assert found is not None  # noqa: S101 - the layout has them
        return found

    return find
