"""The steps of the verb: a surface of a file, its sections, and what is said of them."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from hpcapp.applications.section.cut import cut_mesh
from hpcapp.applications.section.planes import plan_along, plan_planes
from hpcapp.applications.section.sections import Section, Sections
from hpcapp.cancellation import check_cancelled
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.regions.region import say_place
from hpcapp.io import find_mesh_crs, holds_faces, open_points, read_mesh
from hpcapp.io.crs import Crs
from hpcapp.io.geocentric import refuse_geocentric
from hpcapp.io.outlines import Drawn
from hpcapp.io.usable_mesh import check_usable
from hpcapp.parts.crop import Crop
from hpcapp.progress import Progress, StageClock
from hpcapp.wording import say_number
from hpccomponent.errors import InputError
from hpccomponent.files.held_folders import temporary_folder

log = logging.getLogger("hpcapp")


def open_surface(path: Path, crop: Crop, progress: Progress) -> tuple[Mesh, Crs]:
    """Read a mesh, or mesh points, and cut out the part that is asked for.

    Raise InputError where the file cannot be read, or nothing is there.
    """
    if not holds_faces(path):
        return _mesh_points(path, crop, progress), open_points(path).frame
    with StageClock(progress).stage("read"):
        mesh, crs = read_mesh(path), find_mesh_crs(path)
        check_usable(mesh, path)
        return crop.cut(mesh, crs.height_scale, str(path)), crs


def _mesh_points(path: Path, crop: Crop, progress: Progress) -> Mesh:
    """Mesh the points of a file as ``hpcapp reconstruct`` does by default."""
    from hpcapp.applications.surface.cli.run import run_job
    from hpcapp.applications.surface.job.settings import JobSettings
    from hpcapp.applications.surface.job.source import MARGIN
    from hpcapp.io.points.inputs import gather_points

    log.info("%s: points, which are meshed first, as by hpcapp reconstruct", path)
    choose = partial(crop.narrow, margin=MARGIN)
    with (
        temporary_folder() as folder,
        gather_points([str(path)], None, for_surface=True, choose=choose) as points,
    ):
        output = folder / "mesh.ply"
        settings = JobSettings(points=points, output=str(output), inputs=(path,), crop=crop)
        report = run_job(settings, progress)
        log.info("the mesh: %s", report["summary"])
        return read_mesh(output)


def make_sections(
    mesh: Mesh, crs: Crs, planes: Sequence[str], lines: Sequence[Drawn] | None,
    step: float | None, width: float | None, name: str,
) -> Sections:  # fmt: skip
    """Cut a mesh by planes that were typed, or across or along lines.

    Raise InputError where none meets it, and of lines where coordinates are from the centre of the
    earth; UsageError where a plane is none, or they are too many.
    """
    low, high = (end + mesh.origin for end in bound_points(mesh.vertices))
    if lines is not None:
        refuse_geocentric(name, low, high, crs)
    cuts = plan_planes(planes, step, low, high) if lines is None else plan_along(lines, step, width)
    scales = np.array([1.0, 1.0, crs.height_scale])
    isotropic = replace(mesh, vertices=mesh.vertices * scales, origin=mesh.origin * scales)
    sections = []
    for cut in cuts:
        check_cancelled()
        sections.append(cut_mesh(isotropic, cut.scale(scales)).scale(1.0 / scales))
    if not any(one.outlines for one in sections):
        where = "no plane" if lines is None else "no section along the line"
        raise InputError(
            f"{name}: {where} meets its surface",
            f"it lies from {say_place(low)} to {say_place(high)}",
        )
    return Sections(tuple(sections), crs)


def list_rows(sections: Sections) -> list[tuple[str, str, str, str, str]]:
    """Return a table of the sections, with its head."""
    head = ("section", "outlines", "closed", "length", "area")
    unit = sections.crs.unit or ""
    rows = [
        (
            one.name, str(len(one.outlines)), str(one.closed), say_number(one.length, unit),
            say_number(one.area, unit and f"{unit}²"),
        )
        for one in sections
    ]  # fmt: skip
    return [head, *rows]


def list_values(sections: Sections) -> list[dict[str, object]]:
    """Return the same as plain values."""
    return [_list_one(one) for one in sections]


def _list_one(section: Section) -> dict[str, object]:
    return {
        "name": section.name, "station": section.station, "line": section.line or None,
        "outlines": len(section.outlines), "closed": section.closed,
        "length": section.length, "area": section.area,
    }  # fmt: skip
