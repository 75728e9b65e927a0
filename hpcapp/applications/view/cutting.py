"""The commands that cut a file, for its page, and the pieces of a mesh."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np

from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.pieces import find_small
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.crs import Crs
from hpcapp.io.geojson import name_crs
from hpcapp.io.registry import list_suffixes
from hpcapp.mending.pieces import measure_pieces
from hpcapp.pages.cutting import Cutting, Pieces

_RANK = "hpcapp:piece"  # the attribute of a mesh that says the rank of a vertex's piece


def plan_cutting(path: Path, shown: Mesh | PointCloud, crs: Crs) -> Cutting:
    """Return the commands that cut a file into another one beside it."""
    suffix = path.suffix.lower()
    if isinstance(shown, Mesh):
        places, written = shown.vertices, list_suffixes(lambda one: one.mesh_writer)
        verbs = {"mesh": ("mend", suffix if suffix in written else ".ply")}
    else:
        places, written = shown.positions, list_suffixes(lambda one: one.point_writer)
        points = suffix if suffix in written else ".ply"
        verbs = {"points": ("convert", points), "mesh": ("reconstruct", ".ply")}
    commands = {
        label: shlex.join(["hpcapp", verb, str(path), "-o", str(_name_beside(path, ending))])
        for label, (verb, ending) in verbs.items()
    }
    finite = places[np.isfinite(places).all(axis=1)]
    bounds = np.stack(bound_points(finite)) if len(finite) else np.zeros((2, 3))
    plain = re.sub(r"[^\w.-]", "_", path.stem, flags=re.ASCII)
    return Cutting(commands, bounds, f"polygon-{plain}.geojson", name_crs(crs.text))


def _name_beside(path: Path, suffix: str) -> Path:
    return path.with_name(f"{path.stem}-cut{suffix}")


def mark_pieces(mesh: Mesh) -> tuple[Mesh, FloatArray]:
    """Give the vertices of a mesh the ranks of their pieces; return the areas (p,) by rank, too.

    Pieces are those that ``--pieces`` keeps, largest first. A mesh of a single piece has no marks,
    nor one with a vertex that is no place.
    """
    pieces, areas = measure_pieces(mesh)
    if len(areas) < 2 or not np.isfinite(areas).all():
        return mesh, areas
    order = np.argsort(-areas, kind="stable")  # as PieceChoice chooses
    ranks = np.empty(len(areas), np.int32)
    ranks[order] = np.arange(len(areas))
    column = np.zeros(len(mesh.vertices), np.int32)
    column[mesh.faces] = ranks[pieces][:, None]
    return replace(mesh, attributes={**mesh.attributes, _RANK: column}), areas[order]


def take_pieces(mesh: Mesh, areas: FloatArray) -> tuple[Mesh, Pieces | None]:
    """Turn the marks of a mesh, or of a copy of it with fewer faces, into its pieces."""
    if _RANK not in mesh.attributes:
        return mesh, None
    rest = {name: column for name, column in mesh.attributes.items() if name != _RANK}
    suggested = len(areas) - int(find_small(areas).sum())
    return replace(mesh, attributes=rest), Pieces(mesh.attributes[_RANK], areas, suggested)
