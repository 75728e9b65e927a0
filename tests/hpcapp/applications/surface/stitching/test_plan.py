"""Parts, however they are cut, weld to the mesh that they were cut from, byte for byte."""

from __future__ import annotations

from dataclasses import astuple, replace
from functools import cache

import numpy as np
import pytest
from cut_mesh import (
    SHAPES,
    cut_mesh,
    cuts,
    drop_small_components,
    extract_shape,
    is_supported,
    spread_mesh,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.extraction.summary import summarize_part
from hpcapp.applications.surface.stitching.assemble import assemble_mesh
from hpcapp.applications.surface.stitching.bricks import missing_bricks
from hpcapp.applications.surface.stitching.plan import StitchingPlan, find_large, plan_stitching
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.lattice import unpack_keys
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import IntArray
from hpcapp.mending.pieces import keep_faces, measure_pieces
from hpccomponent.errors import JobError

ORIGIN = np.array([5.0, 0.0, -3.0])
extracted = cache(extract_shape)


def bricks_of(*keys: IntArray) -> list[int]:
    values: list[int] = np.unique(np.concatenate(keys)).tolist()
    return values


def weld(parts: list[MeshPart]) -> tuple[StitchingPlan, Mesh]:
    summaries = [summarize_part(part) for part in parts]
    plan = plan_stitching(summaries)
    return plan, assemble_mesh(plan, parts.__getitem__, ORIGIN)


def assert_same(plan: StitchingPlan, welded: Mesh, whole: Mesh) -> None:
    assert welded.vertices.tobytes() == whole.vertices.tobytes()
    assert welded.faces.dtype == np.int64
    assert welded.faces.tobytes() == whole.faces.astype(np.int64).tobytes()
    assert welded.origin is ORIGIN
    if len(whole.vertices):
        assert plan.box.tolist() == [
            whole.vertices.min(axis=0).tolist(),
            whole.vertices.max(axis=0).tolist(),
        ]


@settings(max_examples=60)
@given(st.data(), st.sampled_from(sorted(SHAPES)))
def test_any_cut_of_a_closed_mesh_welds_to_the_whole(data: st.DataObject, name: str) -> None:
    mesh, of_vertex, of_face = extracted(SHAPES[name])
    owners, guests = data.draw(cuts(of_vertex, of_face))
    plan, welded = weld(cut_mesh(mesh, of_vertex, of_face, owners, guests))
    whole = drop_small_components(mesh)
    assert_same(plan, welded, whole)
    topology = plan.judge()
    assert topology == check_mesh(whole)
    assert topology.watertight


@settings(max_examples=40)
@given(st.data(), st.sampled_from(["twins", "crumb_in_brick"]), st.booleans())
def test_any_cut_tells_the_pieces_and_gives_some_of_them(
    data: st.DataObject, name: str, is_first: bool
) -> None:
    mesh, of_vertex, of_face = extracted(SHAPES[name])
    whole = drop_small_components(mesh)
    numbers, areas = measure_pieces(whole)
    owners, guests = data.draw(cuts(of_vertex, of_face))
    parts = cut_mesh(mesh, of_vertex, of_face, owners, guests)
    plan, _ = weld(parts)
    components, found = plan.pieces()
    np.testing.assert_allclose(found, areas, rtol=1e-6)
    kept = plan.only(components[:1] if is_first else components[1:])
    welded = assemble_mesh(kept, parts.__getitem__, ORIGIN)
    expected = keep_faces(whole, (numbers == 0) == is_first)
    assert_same(kept, welded, expected)
    assert kept.judge() == check_mesh(expected)


def test_what_is_small_is_dropped_and_shares_a_brick_with_what_is_not() -> None:
    mesh, of_vertex, of_face = extracted(SHAPES["crumb_in_brick"])
    part = cut_mesh(mesh, of_vertex, of_face, dict.fromkeys(bricks_of(of_vertex, of_face), 0))[0]
    plan, welded = weld([part])
    assert len(summarize_part(part).mixed_labels)
    assert 0 < len(mesh.vertices) - plan.vertex_count < 10
    assert len(welded.vertices) == plan.vertex_count


def open_sheet(side: int) -> Mesh:
    i, j = (each.ravel() for each in np.meshgrid(*[np.arange(side)] * 2, indexing="ij"))
    a = (i * (side + 1) + j)[:, None] + np.array([0, side + 1, side + 2, 1])
    faces = np.concatenate([a[:, :3], a[:, [0, 2, 3]]])
    x, y = (each.ravel() for each in np.meshgrid(*[np.arange(side + 1)] * 2, indexing="ij"))
    return Mesh(np.stack([x, y, 0.01 * x * y + 1.0], axis=1).astype(float), faces)


def pinched() -> Mesh:
    """Two tetrahedra that share a vertex."""
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    second = np.array([3, 4, 5, 6])[faces]
    return Mesh(np.random.default_rng(0).random((7, 3)), np.concatenate([faces, second]))


def with_faces(mesh: Mesh, *faces: list[int]) -> Mesh:
    return Mesh(mesh.vertices, np.concatenate([mesh.faces, np.array(faces)]))


def fin() -> Mesh:
    """A third face on an edge of a tetrahedron, and a vertex that no face uses."""
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    vertices = np.random.default_rng(1).random((6, 3))
    return with_faces(Mesh(vertices, tetrahedron), [0, 1, 4])


def turned() -> Mesh:
    sheet = open_sheet(4)
    faces = sheet.faces.copy()
    faces[7] = faces[7, ::-1]
    return Mesh(sheet.vertices, faces)


def collapsed() -> Mesh:
    return with_faces(open_sheet(3), [0, 0, 1], [5, 5, 5])


ODD = {
    "sheet": lambda: open_sheet(6),
    "pinched": pinched,
    "turned": turned,
    "collapsed": collapsed,
    "faceless": lambda: Mesh(np.ones((5, 3)), np.empty((0, 3), np.int64)),
    "empty": lambda: Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64)),
    "fin": fin,
}


@settings(max_examples=200)
@given(st.data(), st.sampled_from(sorted(ODD)), st.integers(0, 2**32 - 1))
def test_the_seams_of_any_mesh_tell_its_topology(data: st.DataObject, name: str, seed: int) -> None:
    mesh = ODD[name]()
    of_vertex, of_face = spread_mesh(
        mesh, data.draw(st.integers(1, 12)), np.random.default_rng(seed)
    )
    owners, guests = data.draw(cuts(of_vertex, of_face))
    plan, welded = weld(cut_mesh(mesh, of_vertex, of_face, owners, guests))
    whole = drop_small_components(mesh)
    assert_same(plan, welded, whole)
    expected, found = check_mesh(whole), plan.judge()
    if not found.vertex_manifold:
        # A vertex that is closed in one part hides the edges there, and where it is from others.
        hidden = ("outward", "edge_manifold", "oriented", "boundary_edges", "vertex_manifold")
        among = hidden if not expected.edge_manifold else hidden[:1]
        found = replace(found, **{name: getattr(expected, name) for name in among})
    assert found == expected


def cut_by_faces(mesh: Mesh, owners: IntArray) -> tuple[Mesh, list[MeshPart]]:
    """Cut a mesh so that each part has some faces; all vertices are in a brick of the first."""
    of_vertex = np.zeros(len(mesh.vertices), np.int64)
    order = np.argsort(owners, kind="stable")
    of_face = np.sort(owners)
    sorted_mesh = Mesh(mesh.vertices, mesh.faces[order])
    keys = {0: 0} | {int(part): int(part) for part in owners}
    return sorted_mesh, cut_mesh(sorted_mesh, of_vertex, of_face, keys)


@pytest.mark.parametrize("name", ["fin", "turned", "pinched", "collapsed"])
@pytest.mark.parametrize("parts", [2, 3, 8])
def test_what_is_wrong_across_a_seam_is_found(name: str, parts: int) -> None:
    mesh, cut = cut_by_faces(ODD[name](), np.arange(len(ODD[name]().faces)) % parts)
    assert weld(cut)[0].judge() == check_mesh(mesh)


def test_a_hole_along_a_seam_is_found() -> None:
    mesh, of_vertex, of_face = extracted(SHAPES["torus"])
    holed = Mesh(mesh.vertices, np.delete(mesh.faces, 100, axis=0))
    owners = {key: i % 3 for i, key in enumerate(bricks_of(of_vertex, of_face))}
    found = weld(cut_mesh(holed, of_vertex, np.delete(of_face, 100), owners))[0].judge()
    assert found == check_mesh(holed)
    assert found.boundary_edges == 3


def halves() -> list[MeshPart]:
    mesh, of_vertex, of_face = extracted(SHAPES["torus"])
    keys = bricks_of(of_vertex, of_face)
    owners = {key: int(i > len(keys) // 2) for i, key in enumerate(keys)}
    return cut_mesh(mesh, of_vertex, of_face, owners)


def test_a_brick_that_no_part_has_is_named() -> None:
    summary = summarize_part(halves()[0])
    missing = missing_bricks([summary])
    assert np.array_equal(missing, np.unique(summary.foreign_bricks))
    x, y, z = unpack_keys(missing[:1])[0]
    with pytest.raises(JobError, match=rf"brick \({x}, {y}, {z}\)"):
        plan_stitching([summary])


def test_a_vertex_that_its_brick_does_not_have_is_refused() -> None:
    first, second = halves()
    numbers = np.full(len(first.foreign_numbers), 9999, np.int32)
    parts = [replace(first, foreign_numbers=numbers), second]
    with pytest.raises(JobError, match="no tile has the vertices"):
        plan_stitching([summarize_part(part) for part in parts])


def test_two_owners_of_a_brick_are_refused() -> None:
    first, _ = halves()
    with pytest.raises(JobError, match="disagree"):
        plan_stitching([summarize_part(first)] * 2)


def test_a_summary_is_small_beside_its_part() -> None:
    mesh, of_vertex, of_face = extracted(SHAPES["torus"])
    part = cut_mesh(mesh, of_vertex, of_face, dict.fromkeys(bricks_of(of_vertex, of_face), 0))[0]
    sizes = [sum(a.nbytes for a in astuple(each)) for each in (summarize_part(part), part)]
    assert sizes[0] < 0.1 * sizes[1]


@pytest.mark.parametrize(
    ("size", "supported", "stays"),
    [
        (0.03, 0.0, True),  # too large to be a mere crumb
        (0.01, 0.1, False),  # what grew around outliers
        (0.01, 0.5, True),
        (0.001, 0.5, False),
        (0.001, 0.8, True),  # the tip of a horn
        (0.0003, 1.0, False),
    ],
)
def test_the_smaller_a_component_is_the_more_of_it_must_be_supported(
    size: float, supported: float, stays: bool
) -> None:
    faces = np.array([200_000, round(200_000 * size)])
    supports = np.rint(0.5 * faces * [0.85, supported]).astype(np.int64)
    assert find_large(faces, supports).tolist() == [True, stays]
    assert find_large(faces[::-1], supports[::-1]).tolist() == [stays, True]


def test_where_nothing_is_small_what_no_face_uses_stays() -> None:
    none = np.zeros(3, np.int64)
    assert find_large(np.array([10, 0]), none[:2]).all()
    assert not find_large(np.array([10_000, 1, 0]), none)[1:].any()
    assert not len(find_large(none[:0], none[:0]))


def test_a_clump_of_strays_goes_whatever_supports_it() -> None:
    faces, supports = np.array([4_000, 70, 120]), np.array([2_000, 35, 60])
    assert find_large(faces, supports).all()
    assert find_large(faces, supports, 100.0).tolist() == [True, False, True]
    assert find_large(faces[:1], supports[:1], 9_000.0).all()


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_what_supports_a_mesh_is_counted_once_however_it_is_cut(data: st.DataObject) -> None:
    mesh, of_vertex, of_face = extracted(SHAPES["torus"])
    parts = cut_mesh(mesh, of_vertex, of_face, *data.draw(cuts(of_vertex, of_face)))
    plan = plan_stitching([summarize_part(part) for part in parts])
    assert plan.entries.supports.sum() == is_supported(mesh.vertices).sum()
