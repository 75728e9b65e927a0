"""The page of a job: its mesh, what the points say of it, and all that the job decided and did."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from hpcapp.applications.surface.attributes.carrying import Carrying
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.geometry.axis_names import AXES
from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpcapp.geometry.support import GUESSED, SUPPORT
from hpcapp.io import open_points, read_mesh, read_whole, take_finite
from hpcapp.io.crs import UNKNOWN
from hpcapp.io.frame import scale_heights
from hpcapp.io.meshes.mesh_stream import MeshStream, find_vertices, make_mesh
from hpcapp.io.placement import choose_up
from hpcapp.pages.job import describe_job, find_unit
from hpcapp.pages.owners import TILE, Owners, mark_tiles, take_labels
from hpcapp.pages.page import build_page, tabulate, write_page
from hpcapp.pages.scene import MOST_POINTS, Field, Marker, Scene, Tint, fields_of
from hpcapp.pages.thin import thin_mesh
from hpcapp.wording import say_count, say_number, say_share
from hpccomponent.dataclass import dataclass

if TYPE_CHECKING:
    from hpcapp.applications.surface.job.outcome import Outcome, Reconstruction
    from hpcapp.applications.surface.job.scan import Loaded


_LEAST_SHARE = 0.002  # of the area, that a place must have to be marked
_MOST_MARKERS = 8
_WIDEST = 8.0  # spacings at the end of the scale of colours


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What a job's page draws.

    The `mesh` has as many faces as a page shows, of all its `faces`; `points` are a sample, in its
    frame. `distances` (v,) are from its vertices to the nearest of all points, in length units of
    the input; `labels` tell tiles and workers.
    """

    mesh: Mesh
    faces: int
    points: PointCloud
    distances: FloatArray
    labels: tuple[Field, ...] = ()


def show_job(loaded: Loaded, outcome: Outcome, carrying: Carrying) -> Shown:
    """Gather what the page of a job draws, at bounded memory.

    It is drawn undistorted: heights are in the unit of x and y.
    """
    bare = replace(carrying, has_normals=False, crs=UNKNOWN)
    stream = bare.to_stream(outcome.result.surface.stream())
    owners = find_owners(outcome.result)
    if owners is not None:
        stream = _with_column(stream, TILE, owners.tiles)
    spacing = float(outcome.result.facts.get("spacing", 0.0))
    return show_cloud(stream, loaded.cloud, spacing, () if owners is None else owners.workers)


def show_cloud(
    stream: MeshStream, cloud: ArrangedCloud, spacing: float, workers: Sequence[str] = ()
) -> Shown:
    """Gather what a page draws of a mesh and its points, and of the workers that made its tiles.

    The spacing is asked for where the points lie in a folder.
    """
    mesh, labels = take_labels(thin_mesh(stream), workers)
    points = cloud.sample(MOST_POINTS)
    return Shown(
        mesh,
        stream.face_count,
        points.take(np.arange(0, len(points), max(1, -(-len(points) // MOST_POINTS)))),
        _measure(cloud, spacing, mesh.vertices),
        tuple(labels),
    )


def find_owners(result: Reconstruction) -> Owners | None:
    """Return which tile each vertex of a job's mesh is from; None where there is only one."""
    tiles = result.surface.owners() if int(result.facts.get("tiles", 1)) > 1 else None
    return None if tiles is None else Owners(tiles, result.surface.makers())


def _with_column(stream: MeshStream, name: str, column: IntArray) -> MeshStream:
    """Return a mesh whose vertices have one attribute more."""

    def vertices() -> Iterator[PointCloud]:
        start = 0
        for block in stream.vertices():
            rows = column[start : start + len(block)]
            yield replace(block, attributes={**block.attributes, name: rows})
            start += len(block)

    layout = replace(stream.layout, attributes={**stream.layout.attributes, name: column[:0]})
    return replace(stream, vertices=vertices, layout=layout)


def _measure(cloud: ArrangedCloud, spacing: float, places: FloatArray) -> FloatArray:
    """Return the distance of places from the nearest point, wherever the points are."""
    if cloud.is_here:
        positions = cloud.take_columns(cloud.keys).positions
        tree = cKDTree(positions, compact_nodes=False, balanced_tree=False)
        distances: FloatArray = tree.query(places, workers=-1)[0]
        return distances
    from hpcapp.applications.surface.attributes.search import evaluate_blocks

    return evaluate_blocks(cloud, cloud.take_columns, (), spacing, places).nearest


def show_files(mesh: Path, points: Path, report: Mapping[str, Any]) -> Shown:
    """Gather what the page of a job draws that has run elsewhere.

    With ``owners`` its report tells which tiles the mesh is from. Raise InputError where a file
    cannot be read.
    """
    source = open_points(points).isotropic()
    whole = read_mesh(mesh)
    vertices = replace(find_vertices(whole), origin=whole.origin)
    vertices = scale_heights(vertices, source.frame.height_scale)
    whole = make_mesh(vertices, whole.faces, vertices.origin)
    marked, workers = mark_tiles(whole, mesh, report, "the head's report")
    thin, labels = take_labels(thin_mesh(marked), workers)
    cloud = take_finite(read_whole(source), str(points))
    cloud = replace(cloud, positions=cloud.positions + (cloud.origin - whole.origin))
    distances: FloatArray = cKDTree(cloud.positions).query(thin.vertices, workers=-1)[0]
    return Shown(thin, len(whole.faces), cloud, distances, tuple(labels))


def build_job_page(shown: Shown, report: Mapping[str, Any], title: str) -> str:
    """Return the page of a job, as HTML."""
    spacing, unit, tint = report.get("spacing"), find_unit(report), None
    fields = [Field("distance", "Distance to the points", shown.distances, unit, low=0.0)]
    markers: list[Marker] = []
    if spacing:
        support = shown.distances / float(spacing)
        fields.append(Field(SUPPORT, "Distance in spacings", support, "spacings", 0.0, _WIDEST))
        beyond = _find_reach(report, float(spacing))
        markers = find_guesses(shown.mesh, shown.distances, beyond, float(spacing), unit)
        if float(shown.distances.max(initial=0.0)) > beyond:
            text = f"guesswork: more than {say_number(beyond, unit)} from every point"
            tint = Tint("distance", beyond, text)
    own = [one for one in fields_of(shown.mesh) if one.label != SUPPORT]
    scene = Scene(
        shown.mesh, [*fields, *shown.labels, *own], shown.points, markers,
        up=find_up(report, shown.mesh), unit=unit, tint=tint,
    )  # fmt: skip
    sections = describe_job(report, [one.text for one in markers])
    if len(shown.mesh.faces) < shown.faces:
        note = {"faces": shown.faces, "shown here": len(shown.mesh.faces)}
        sections.insert(0, tabulate("A copy with fewer faces is shown", note))
    return build_page(title, str(report["summary"]), scene, sections)


def _find_reach(report: Mapping[str, Any], spacing: float) -> float:
    """Return how far from the nearest point a surface is guesswork, in length units."""
    support = report.get("support")
    reach = support.get("reach") if isinstance(support, Mapping) else None
    if isinstance(reach, int | float) and reach > 0.0:
        return float(reach)
    return GUESSED * spacing


def find_up(report: Mapping[str, Any], mesh: Mesh) -> str:
    """Return the axis that points up: as the report tells, else as the mesh stands."""
    known = report.get("up")
    return choose_up(mesh, known if known in AXES else None)


def find_guesses(
    mesh: Mesh, distances: FloatArray, beyond: float, spacing: float, unit: str = ""
) -> list[Marker]:
    """Return where a mesh is guesswork: the largest pieces of it that are far from all points.

    That is where the `distances` (v,) of its vertices from the nearest point exceed `beyond`, in
    length units. Markers come largest first, each in the middle of a piece, on the mesh; `unit` of
    length is for their texts.
    """
    is_far = (distances > beyond)[mesh.faces].all(axis=1)
    faces = mesh.faces[is_far]
    if not len(faces):
        return []
    corners = mesh.vertices[mesh.faces]
    areas = np.linalg.norm(cross_edges(corners), axis=1)
    total, areas = float(areas.sum()), areas[is_far]
    count = len(mesh.vertices)
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = coo_array((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), (count, count))
    piece = connected_components(graph, directed=False)[1][faces[:, 0]]
    sizes = np.bincount(piece, areas)
    markers = []
    for one in np.argsort(-sizes, kind="stable")[:_MOST_MARKERS].tolist():
        if sizes[one] < _LEAST_SHARE * total:
            break
        mine = piece == one
        middles = corners[is_far][mine].mean(axis=1)
        middle = np.average(middles, axis=0, weights=areas[mine])
        place = middles[int(np.argmin(np.linalg.norm(middles - middle, axis=1)))]
        farthest = float(distances[faces[mine]].max())
        markers.append(
            Marker(
                place,
                f"{say_share(sizes[one] / total)} of the surface is guesswork: up to "
                f"{say_number(farthest, unit)} from the nearest point "
                f"({say_count(round(farthest / spacing), 'spacing')})",
            )
        )
    return markers


def write_job_page(path: Path, shown: Shown, report: Mapping[str, Any], title: str) -> None:
    """Write the page of a job, which appears whole or not at all."""
    write_page(path, build_job_page(shown, report, title))
