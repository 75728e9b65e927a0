"""Normals for points that have none: estimated, and turned to one side over the whole object.

::

    regions ── estimate ──> normals without a side ── patches, links ──> sides ── turn ──> normals

This module takes its time to be imported, and is only where it is needed.
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.cloud.cloud_pass import PassT
from hpcapp.applications.surface.cloud.measure import draw_places
from hpcapp.applications.surface.normals import estimation, patches
from hpcapp.applications.surface.normals.orientation import SURE, Doubt, ScanVerdict, orient_patches
from hpcapp.applications.surface.normals.oriented import Oriented, Unsure
from hpcapp.applications.surface.normals.patterns import CONFIDENCE_BINS
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.applications.surface.normals.tasks import estimate_region, group_region, turn_region
from hpcapp.applications.surface.scale.depth_image import has_pixels
from hpcapp.geometry.axes import rotate
from hpcapp.geometry.lattice import lay_lattice
from hpcapp.geometry.points import FloatArray

_SAMPLE = 20_000  # points that are looked at for the pixels of a camera


def orient_normals(
    cloud_pass: PassT,
    spacing: float,
    sensor: Sensor,
    *,
    keeps: bool,
    attribute: str | None = None,
) -> tuple[PassT, Oriented, ScanVerdict | None]:
    """Give points unit normals that are on one side, and tell how the scan was seen, if that told.

    Where the normals that are there count (`keeps`), only their side is found; else all is
    estimated. `flipped` are the opposites of what they were. By the name of an `attribute`, points
    keep how sure their side is, 0 to 1. InputError where cameras cannot have seen the points.
    """
    cloud = cloud_pass.cloud
    given = lay_lattice(cloud.low, spacing), spacing
    margin = estimation.MARGIN * spacing
    # From here until they are turned, normals are as long as the noise of their points.
    cloud_pass, _ = cloud_pass.rewrite(estimate_region, *given, keeps, margin=margin)
    margin = patches.MARGIN * spacing
    grouped = cloud_pass.each(group_region, *given, margin=margin)
    found = patches.merge_patches(grouped)
    sensor.check_sight(found[0].centres, -cloud.origin)
    if sensor.kind == "unknown" and sensor.upright is None:
        # Where the file tells nothing, its points may: if they lie like pixels, seen from zero.
        sample = draw_places(cloud_pass, patches.CELL * spacing, len(cloud) // _SAMPLE + 1)
        if has_pixels(sample + cloud.origin):
            sensor = Sensor("places", np.zeros((1, 3)))
    # Sides are told in a frame whose z is up.
    upright, zero = sensor.upright, rotate(-cloud.origin, sensor.upright)
    turned = found[0].rotate(upright), found[1].rotate(upright)
    oriented = orient_patches(*turned, spacing, zero, sensor.rotate(), cloud_pass.threads)
    # They take much memory, and the points are read again below.
    del found, turned
    del grouped
    cloud_pass, results = cloud_pass.rewrite(
        turn_region,
        *given,
        oriented.sides,
        attribute is not None,
        margin=margin,
        attribute=attribute,
    )
    flipped = sum(opposite for opposite, *_ in results)
    # (100,): points of all regions by the bin of their confidence.
    confidences = np.sum([binned for _, binned, *_ in results], axis=0)
    sure = float(confidences[round(SURE * CONFIDENCE_BINS) :].sum()) / len(cloud)
    doubt = None if oriented.doubt is None else _tell_doubt(oriented.doubt, cloud.origin, upright)
    found_sides = Oriented("estimated", sure, flipped, how=oriented.how, doubt=doubt)
    return cloud_pass, found_sides, oriented.verdict


def _tell_doubt(doubt: Doubt, origin: FloatArray, upright: FloatArray | None) -> Unsure:
    """Return a doubt in the file's coordinates."""
    back = None if upright is None else upright.T
    place = tuple((rotate(doubt.middle, back) + origin).tolist())
    if doubt.rival is None:
        return Unsure(place)
    readings = doubt.reading, doubt.rival
    words = [reading.word or reading.name for reading in readings]
    if words[0] == words[1]:  # both look from above, but from other sides
        words = [reading.name for reading in readings]
    options = [
        word
        if reading.place is None or word == reading.word
        else _type_place(rotate(reading.place, back), origin)
        for word, reading in zip(words, readings, strict=True)
    ]
    seen = tuple(reading.evidence.how for reading in readings)
    return Unsure(place, seen, tuple(options))


def _type_place(place: FloatArray, origin: FloatArray) -> str:
    """Return a place far from the middle of a cloud for the option that says it."""
    # Four digits of the largest coordinate of the cloud's frame: more do not matter.
    digits = 3 - int(np.floor(np.log10(max(float(np.abs(place).max()), 1e-300))))
    return ",".join(f"{round(value, digits) + 0.0:.15g}" for value in (place + origin).tolist())
