"""What there is to know of a point cloud before it is reconstructed."""

from __future__ import annotations

import math

import numpy as np

from hpcapp.applications.points.noise import find_noise
from hpcapp.applications.points.rejected import reject_points
from hpcapp.applications.surface.cleaning.repeated import find_repeated
from hpcapp.applications.surface.cloud.arranged import MemoryCloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.cloud.surface_check import check_surface
from hpcapp.applications.surface.normals.sides import CONTRADICTING, measure_opposed
from hpcapp.applications.surface.reading.reach import drop_far
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import PointSource, drop_unusable, read_whole
from hpcapp.io.frame import scale_heights
from hpcapp.io.points.column_roles import tell_use
from hpcapp.io.points.inputs import find_sample
from hpcapp.io.points.point_source import Findings
from hpccomponent.errors import InputError


def describe_file(source: PointSource) -> tuple[dict[str, object], Findings, PointCloud]:
    """Read a file's points, and tell what it holds; raise InputError where it is damaged.

    Returns
    -------
    facts : dict
        JSON values. ``format``; ``columns``: as what each of them was taken, by its name;
        ``normals``: where they are from, ``file`` or ``faces``, or None; ``is_oriented``:
        False where their signs are not known or contradict each other, None without them;
        ``opposed_normals``: share of neighbours whose normals do, or None; ``attributes``: names
        of other columns that are kept; ``sample``: how many points on its faces a job takes in
        place of a mesh's vertices, or None; ``scans``: for each its ``points``, ``scanner`` and
        ``grid``, or None; ``grid`` of the first; ``crs``; ``unit``; ``height_unit``: of z, where
        it is stated of that alone; ``up``: which way that is, and why; ``dropped``: points that
        are no part of the cloud, by reason; ``warnings``; and all that `describe` and
        `measure_spacing` tell.
    cloud : PointCloud
        The points, z in the unit of x and y.
    """
    cloud = read_whole(source)
    upright = scale_heights(cloud, source.frame.height_scale)
    warnings = [*source.findings.warnings, *_tell_no_surface(upright)]
    findings = Findings(warnings, _count_dropped(source, cloud))
    scale = measure_spacing(upright)
    opposed = _measure_opposed(upright, scale["spacing"])
    facts = {
        "format": source.format,
        **describe(cloud),
        **scale,
        "normals": source.normals_from if cloud.normals is not None else None,
        "is_oriented": None
        if cloud.normals is None
        else source.oriented and (opposed is None or opposed <= CONTRADICTING),
        "opposed_normals": opposed,
        "attributes": list(cloud.attributes),
        "columns": {name: tell_use(name, cloud) for name in source.columns},
        "sample": find_sample(source.path),
        "scans": [
            {
                "points": scan.points,
                "scanner": None if scan.scanner is None else scan.scanner.tolist(),
                "grid": None if scan.grid is None else list(scan.grid),
            }
            for scan in source.scans
        ],
        "grid": None if source.scans[0].grid is None else list(source.scans[0].grid),
        "crs": source.crs,
        "unit": source.unit,
        "height_unit": source.height_unit,
        "up": source.up,
        "dropped": findings.dropped,
        "warnings": findings.warnings,
    }
    return facts, findings, upright


def _tell_no_surface(cloud: PointCloud) -> list[str]:
    """Return why no surface is made of points without normals, if they fill a volume, say."""
    if cloud.normals is not None:
        return []
    try:
        usable, _ = drop_unusable(cloud, "the cloud")
        positions = drop_far(usable).positions
        distinct = PointCloud(positions[~find_repeated(positions)])
        cloud_pass = MemoryPass(MemoryCloud.as_they_are(distinct))
        problem = check_surface(cloud_pass, estimate_spacing(distinct.positions))
    except InputError:  # they are too few, or too far
        return []
    return [] if problem is None else [str(problem)]


def _measure_opposed(cloud: PointCloud, spacing: object) -> float | None:
    """Return the share of neighbours whose normals oppose each other, where a job would ask."""
    if cloud.normals is None or not isinstance(spacing, float):
        return None
    usable, _ = drop_unusable(cloud, "the cloud")
    return measure_opposed(MemoryPass(MemoryCloud.as_they_are(usable)), spacing)


def _count_dropped(source: PointSource, cloud: PointCloud) -> dict[str, int]:
    """Count, by reason, what its reader leaves out and the points (or normals) not finite."""
    is_finite = np.isfinite(cloud.positions).all(axis=1)
    if cloud.normals is not None:
        is_finite &= np.isfinite(cloud.normals).all(axis=1)
    not_finite = len(cloud) - int(is_finite.sum())
    return source.findings.dropped | ({"not finite": not_finite} if not_finite else {})


def describe(cloud: PointCloud) -> dict[str, object]:
    """Count and measure a point cloud as it was read, unusable points included, in JSON values.

    ``bounds`` (lowest and highest corner, in the input's coordinates), ``extent`` (per axis) and
    ``diagonal`` are over finite points and None where there are none; ``origin`` was subtracted on
    reading; ``non_finite_points`` and ``non_finite_normals`` count rows with NaN or infinity;
    ``duplicates`` finite points at the place of another, the first at each place not counted.
    """
    finite = cloud.positions[np.isfinite(cloud.positions).all(axis=1)]
    return {
        "points": len(cloud),
        "has_normals": cloud.normals is not None,
        "has_colours": cloud.colours is not None,
        **_measure(finite, cloud.origin),
        "origin": cloud.origin.tolist(),
        "non_finite_points": len(cloud) - len(finite),
        **_count_normals(cloud.normals),
        "duplicates": int(find_repeated(finite).sum()),
    }


def _measure(finite: FloatArray, origin: FloatArray) -> dict[str, object]:
    if not len(finite):
        return {"bounds": None, "extent": None, "diagonal": None}
    low, high = bound_points(finite)
    return {
        "bounds": [(low + origin).tolist(), (high + origin).tolist()],
        "extent": (high - low).tolist(),
        "diagonal": math.hypot(*(high - low)),
    }


def _count_normals(normals: FloatArray | None) -> dict[str, int]:
    if normals is None:
        return {"non_finite_normals": 0, "zero_normals": 0}
    return {
        "non_finite_normals": int((~np.isfinite(normals).all(axis=1)).sum()),
        "zero_normals": int((normals == 0).all(axis=1).sum()),
    }


def measure_spacing(cloud: PointCloud) -> dict[str, object]:
    """Measure how far apart points are, as a job does; z is in the unit of x and y.

    Values are for JSON, None where a job would refuse the points. ``spacing``, and
    ``spacing_range`` from place to place, are those of the points that a job takes; ``scan_lines``
    has their ``gap``, the ``step`` along them, and how many points they ``spared``, or is None
    without any; ``noise`` and ``noise_range`` are standard deviations along the normals.
    """
    try:
        usable, _ = drop_unusable(cloud, "the cloud")
        is_rejected, cleaned, scale = reject_points(usable)
        noise = find_noise(usable.take(np.flatnonzero(~is_rejected)), scale)
    except InputError:
        names = "spacing", "spacing_range", "scan_lines", "noise", "noise_range"
        return dict.fromkeys(names)
    return {
        "spacing": scale.spacing,
        "spacing_range": list(scale.range),
        "scan_lines": cleaned.tell_lines(),
        "noise": noise.usual,
        "noise_range": list(noise.range),
    }
