"""The page of one file: what is in it, and what can be said of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.applications.view.cutting import mark_pieces, plan_cutting, take_pieces
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import (
    find_mesh_crs,
    find_mesh_up,
    holds_faces,
    open_points,
    read_mesh,
    read_whole,
    take_finite,
)
from hpcapp.io.crs import Crs
from hpcapp.io.meshes.mesh_stream import as_stream
from hpcapp.io.placement import choose_up
from hpcapp.pages.job import describe_job, find_unit
from hpcapp.pages.owners import mark_tiles, take_labels
from hpcapp.pages.page import build_page, tabulate
from hpcapp.pages.report import read_report
from hpcapp.pages.scene import Field, Scene, fields_of
from hpcapp.pages.thin import thin_mesh
from hpcapp.parts.crop import EVERYTHING, Crop


def read_shown(path: Path, crop: Crop = EVERYTHING) -> Mesh | PointCloud:
    """Read a file as a mesh where it holds faces, and as finite points otherwise; a part of it.

    Raise InputError where it cannot be read, or holds nothing that can be shown, and UsageError
    where the suffix is unknown.
    """
    if holds_faces(path):
        return crop.cut(read_mesh(path), find_mesh_crs(path).height_scale, str(path))
    return _read_finite(path, crop)


def find_shown_unit(path: Path, shown: Mesh | PointCloud) -> str:
    """Return the unit of the coordinates in a file; nothing where it does not say that."""
    return _find_crs(path, shown).unit or ""


def _find_crs(path: Path, shown: Mesh | PointCloud) -> Crs:
    """Return what the coordinates in a file mean."""
    return open_points(path).frame if isinstance(shown, PointCloud) else find_mesh_crs(path)


def find_shown_up(path: Path, shown: Mesh | PointCloud) -> str:
    """Return the axis that points up: as the file says, else as a mesh stands."""
    if isinstance(shown, PointCloud):
        return "z"
    return choose_up(replace(as_stream(shown), crs=find_mesh_crs(path)), find_mesh_up(path))


def make_page(
    path: Path,
    shown: Mesh | PointCloud,
    points: Path | None = None,
    report: Path | None = None,
    up: str = "z",
    crop: Crop = EVERYTHING,
) -> str:
    """Return the page of a file, as HTML, with its name for a title.

    Points are shown beside a mesh; the report is that of its job, as JSON. Raise InputError where
    one of these cannot be used.
    """
    facts = {} if report is None else read_report(report)
    sections = [] if report is None else describe_job(facts, has_mesh=False)
    crs = _find_crs(path, shown)
    cutting = None if crop.has_region else plan_cutting(path, shown, crs)  # no cut of a cut
    frame = Scene(
        None, up=up, unit=crs.unit or "", origin=shown.origin, height_scale=crs.height_scale,
        cutting=cutting,
    )  # fmt: skip
    if isinstance(shown, PointCloud):
        sections.insert(0, tabulate("Points", _describe_points(shown)))
        scene = _show_points(shown, frame)
        return build_page(path.name, f"{len(shown):,} points", scene, sections)
    topology = check_mesh(shown)
    marked, workers = mark_tiles(shown, path, facts, str(report))
    marked, areas = mark_pieces(marked)
    thin, labels = take_labels(thin_mesh(marked), workers)
    thin, pieces = take_pieces(thin, areas)
    rows: dict[str, object] = {
        "vertices": topology.vertices,
        "faces": topology.faces,
        "watertight": topology.watertight,
        "edges without a neighbour": topology.boundary_edges,
        "pieces": topology.components,
        **_describe_box(shown.vertices, shown.origin),
    }
    if len(thin.faces) < len(shown.faces):
        rows["shown"] = f"a copy with {len(thin.faces):,} faces"
    sections.insert(0, tabulate("Mesh", rows))
    cloud = None if points is None else _read_beside(points, shown, crop)
    stated = find_unit(facts) if points is None else open_points(points).unit
    unit = stated or frame.unit
    measured = [] if cloud is None else [_measure(thin, cloud, unit)]
    fields = [*fields_of(thin), *measured, *labels]
    closed = "watertight" if topology.watertight else "not watertight"
    summary = f"{topology.vertices:,} vertices, {topology.faces:,} faces, {closed}"
    cutting = cutting and replace(cutting, pieces=pieces)
    scene = replace(frame, mesh=thin, fields=fields, points=cloud, unit=unit, cutting=cutting)
    return build_page(path.name, summary, scene, sections)


def _show_points(cloud: PointCloud, frame: Scene) -> Scene:
    """Return points alone: in their colours, else by their normals, else by their heights."""
    axis = "xyz".index(frame.up[-1])
    heights = cloud.positions[:, axis] + cloud.origin[axis]
    fields = [Field("height", "Height", heights, frame.unit), *fields_of(cloud)]
    colouring = "height" if cloud.normals is None else "normals"
    if cloud.colours is not None:
        colouring = "colours"
    return replace(frame, fields=fields, points=cloud, colouring=colouring)


def _describe_points(cloud: PointCloud) -> dict[str, object]:
    return {
        "points": len(cloud),
        "colours": cloud.colours is not None,
        "normals": cloud.normals is not None,
        "attributes": ", ".join(cloud.attributes) or "none",
        **_describe_box(cloud.positions, cloud.origin),
    }


def _describe_box(positions: FloatArray, origin: FloatArray) -> dict[str, str]:
    finite = positions[np.isfinite(positions).all(axis=1)]
    if not len(finite):
        return {}
    low, high = bound_points(finite)

    def say(corner: FloatArray) -> str:
        return "  ".join(f"{value:,.9g}" for value in corner)

    return {"lowest": say(low + origin), "highest": say(high + origin), "extent": say(high - low)}


def _read_finite(path: Path, crop: Crop) -> PointCloud:
    return take_finite(read_whole(crop.take(open_points(path))), str(path))


def _read_beside(path: Path, mesh: Mesh, crop: Crop) -> PointCloud:
    """Read points into the frame of a mesh."""
    cloud = _read_finite(path, crop)
    return replace(cloud, positions=cloud.positions + (cloud.origin - mesh.origin))


def _measure(mesh: Mesh, cloud: PointCloud, unit: str) -> Field:
    """Return the distance of each vertex from the nearest point."""
    finite = np.nan_to_num(mesh.vertices)
    distances, _ = cKDTree(cloud.positions).query(finite, workers=-1)
    return Field("distance", "Distance to the points", distances, unit, low=0.0)
