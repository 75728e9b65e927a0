"""The page of a job: its mesh, what the points say of it, and all that the job decided and did."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from hpcapp.applications.surface.attributes.carrying import SUPPORT, Carrying
from hpcapp.applications.surface.types.mesh import Mesh
from hpcapp.applications.surface.types.points import FloatArray, IntArray, PointCloud
from hpcapp.io import open_points, read_mesh, read_whole, take_finite
from hpcapp.io.crs import UNKNOWN
from hpcapp.io.frame import scale_heights
from hpcapp.io.meshes.mesh_stream import MeshStream, find_vertices, make_mesh
from hpcapp.pages.job import describe_job
from hpcapp.pages.owners import TILE, Owners, mark_tiles, take_labels
from hpcapp.pages.page import Section, build_page, make_table, write_page
from hpcapp.pages.scene import MOST_POINTS, Field, Marker, Scene, fields_of
from hpcapp.pages.thin import thin_mesh

if TYPE_CHECKING:
    from hpcapp.applications.surface.job.load import Loaded
    from hpcapp.applications.surface.job.steps import Outcome
    from hpcapp.applications.surface.pipeline import Reconstruction

__all__ = [
    "Shown",
    "build_job_page",
    "find_guesses",
    "find_owners",
    "show_files",
    "show_job",
    "write_job_page",
]

GUESSED = 6.0
"""Spacings from the nearest point, beyond which a vertex is guesswork."""
_LEAST_SHARE = 0.002  # of the area, that a place must have to be marked
_MOST_MARKERS = 8
_WIDEST = 8.0  # spacings at the end of the scale of colours


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What a job's page draws.

    Parameters
    ----------
    mesh : Mesh
        With as many faces as a page shows.
    faces : int
        Of the mesh itself.
    points : PointCloud
        A sample, in the frame of the mesh.
    distances : ndarray of float64, shape (v,)
        From the vertices to the nearest of all points, in length units of the input.
    labels : tuple of Field
        Tiles and workers.
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
    mesh, labels = take_labels(thin_mesh(stream), () if owners is None else owners.workers)
    points = loaded.cloud.sample(MOST_POINTS)
    return Shown(
        mesh,
        stream.face_count,
        points.take(np.arange(0, len(points), max(1, -(-len(points) // MOST_POINTS)))),
        _measure(loaded, outcome, mesh.vertices),
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


def _measure(loaded: Loaded, outcome: Outcome, places: FloatArray) -> FloatArray:
    """Return the distance of places from the nearest point, wherever the points are."""
    cloud = loaded.cloud
    if cloud.points is not None:
        tree = cKDTree(cloud.points.positions, compact_nodes=False, balanced_tree=False)
        distances: FloatArray = tree.query(places, workers=-1)[0]
        return distances
    from hpcapp.applications.surface.attributes.search import evaluate_blocks

    spacing = float(outcome.result.facts["spacing"])
    take = lambda keys: PointCloud(cloud.take_blocks(keys)[0])  # noqa: E731 - it is one expression
    return evaluate_blocks(cloud, take, (), spacing, places).nearest


def show_files(mesh: Path, points: Path, report: Mapping[str, Any]) -> Shown:
    """Gather what the page of a job draws that has run elsewhere.

    Parameters
    ----------
    report : mapping
        The job's report; with ``owners`` it tells which tiles the mesh is from.

    Raises
    ------
    InputError
        One of them cannot be read.
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
    spacing = report.get("spacing")
    fields = [Field("distance", "Distance to the points", shown.distances, low=0.0)]
    markers: list[Marker] = []
    if spacing:
        support = shown.distances / float(spacing)
        fields.append(Field(SUPPORT, "Support", support, "spacings", 0.0, _WIDEST))
        markers = find_guesses(shown.mesh, shown.distances, float(spacing))
    own = [one for one in fields_of(shown.mesh) if one.label != SUPPORT]
    scene = Scene(shown.mesh, [*fields, *shown.labels, *own], shown.points, markers)
    sections = describe_job(report, [one.text for one in markers])
    if len(shown.mesh.faces) < shown.faces:
        note = {"faces": shown.faces, "shown here": len(shown.mesh.faces)}
        sections.insert(0, Section("A copy with fewer faces is shown", make_table(note)))
    return build_page(title, str(report["summary"]), scene, sections)


def find_guesses(mesh: Mesh, distances: FloatArray, spacing: float) -> list[Marker]:
    """Return where a mesh is guesswork: the largest pieces of it that are far from all points.

    Parameters
    ----------
    distances : ndarray of float64, shape (v,)
        Of its vertices from the nearest point, in length units.
    spacing : float
        Of the points, in length units.

    Returns
    -------
    list of Marker
        The largest first; each in the middle of a piece, on the mesh.
    """
    is_far = (distances > GUESSED * spacing)[mesh.faces].all(axis=1)
    faces = mesh.faces[is_far]
    if not len(faces):
        return []
    corners = mesh.vertices[mesh.faces]
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
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
                f"{100.0 * sizes[one] / total:.1f} % of the surface is guesswork: up to "
                f"{farthest:.4g} from the nearest point ({farthest / spacing:.0f} spacings)",
            )
        )
    return markers


def write_job_page(path: Path, shown: Shown, report: Mapping[str, Any], title: str) -> None:
    """Write the page of a job, which appears whole or not at all."""
    write_page(path, build_job_page(shown, report, title))
