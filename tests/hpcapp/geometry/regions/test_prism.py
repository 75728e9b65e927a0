"""A mesh that is cut to polygons ends on their sides, and is split so that it stays one."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from clipped_meshes import area, make_sphere, sample

from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.geometry.regions.clipping import clip_mesh
from hpcapp.geometry.regions.prism import Prism

STAR = [(0.9, 0.0), (0.2, 0.15), (0.1, 0.8), (-0.2, 0.2), (-0.7, -0.1), (0.1, -0.3)]
HOLE = [(-0.1, -0.1), (0.1, -0.05), (0.05, 0.1)]
SHAPES = {
    "a star with a hole": shapely.Polygon(STAR, [HOLE]),
    "two, of which one is apart": shapely.union(
        shapely.Polygon(STAR), shapely.box(-0.6, -0.8, -0.3, -0.5)
    ),
    "a hole with an island": shapely.union(
        shapely.Polygon(STAR, [HOLE]), shapely.Point(0.02, -0.01).buffer(0.03)
    ),
    "many corners within a face": shapely.Point(0.123, 0.321).buffer(0.012, quad_segs=40),
    "sides along edges, corners on vertices": shapely.box(0.0, 0.0, 2.0, 0.5),
}


def grid_box() -> tuple[FloatArray, IntArray]:
    """A block whose walls are vertical, of large faces: -1 to 1, height 1."""
    corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (0.0, 1.0)])
    faces = [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]  # fmt: skip
    return corners, np.array(faces)


def find_border(mesh: Mesh) -> FloatArray:
    """Return the edges that one face has: shape (e, 2, 3)."""
    edges = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    distinct, count = np.unique(edges, axis=0, return_counts=True)
    border: FloatArray = mesh.vertices[distinct[count == 1]]
    return border


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES.keys())
@pytest.mark.parametrize("origin", [(0.0, 0.0), (512.0, -340.0)])
def test_a_mesh_ends_on_the_sides_and_nowhere_else(
    shape: shapely.Geometry, origin: tuple[float, float]
) -> None:
    vertices, faces = make_sphere()
    away = np.array([*origin, 0.0])
    prism = Prism(shape).localise(-away)
    cut = clip_mesh(Mesh(vertices + away, faces), prism)
    topology = check_mesh(cut)
    assert topology.edge_manifold
    assert topology.vertex_manifold
    border = find_border(cut)
    far = shapely.distance(prism.polygons.boundary, shapely.points(border[:, :, :2].reshape(-1, 2)))
    assert far.max() < 1e-6
    assert prism.widen(1e-6).find(cut.vertices).all()
    places = sample(vertices, faces, 200_000)
    share = Prism(shape).find(places).mean()
    assert area(cut.vertices, cut.faces) == pytest.approx(
        share * area(vertices, faces), rel=0.02, abs=2e-4
    )
    middles = (cut.vertices - away)[cut.faces].mean(axis=1)
    normals = np.linalg.det((cut.vertices - away)[cut.faces])
    assert (normals > -1e-9).all()
    assert np.linalg.norm(middles, axis=1).max() <= 1.0


def test_a_flat_mesh_has_the_area_of_the_polygon() -> None:
    square = Mesh(np.array([[-9.0, -9, 1], [9, -9, 2], [9, 9, 3], [-9, 9, 2]]),
                  np.array([[0, 1, 2], [0, 2, 3]]))  # fmt: skip
    for shape in SHAPES.values():
        cut = clip_mesh(square, Prism(shape))
        flat = cut.vertices * (1.0, 1.0, 0.0)
        assert area(flat, cut.faces) == pytest.approx(shape.area, rel=1e-9)
        # The plane goes on: z = 2 + (x + y) / 18.
        heights = 2.0 + cut.vertices[:, :2].sum(axis=1) / 18.0
        np.testing.assert_allclose(cut.vertices[:, 2], heights, atol=1e-9)
        holes = sum(len(one.interiors) for one in shapely.get_parts(shape))
        parts = len(shapely.get_parts(shape))
        assert check_mesh(cut).boundaries == holes + parts
        assert check_mesh(cut).components == parts


def test_vertical_walls_are_cut() -> None:
    vertices, faces = grid_box()
    cut = clip_mesh(Mesh(vertices, faces), Prism(shapely.box(0.25, -3.0, 3.0, 0.5)))
    assert cut.vertices[:, 0].min() == pytest.approx(0.25)
    assert cut.vertices[:, 1].max() == pytest.approx(0.5)
    # Top and bottom 0.75 by 1.5, a wall of 0.75 and one of 1.5, one high each.
    assert area(cut.vertices, cut.faces) == pytest.approx(2 * 0.75 * 1.5 + 0.75 + 1.5)
    assert check_mesh(cut).boundaries == 1


def test_random_polygons_leave_no_crack() -> None:
    vertices, faces = make_sphere()
    random = np.random.default_rng(5)
    for _ in range(20):
        turns = np.sort(random.random(int(random.integers(3, 40)))) * 2.0 * np.pi
        reach = random.random(len(turns)) * 0.9 + 0.05
        shape = shapely.Polygon(np.stack([reach * np.cos(turns), reach * np.sin(turns)], axis=1))
        if not shape.is_valid:
            continue
        cut = clip_mesh(Mesh(vertices, faces), Prism(shape))
        border = find_border(cut)[:, :, :2].reshape(-1, 2)
        assert shapely.distance(shape.boundary, shapely.points(border)).max() < 1e-8
        assert check_mesh(cut).edge_manifold
        assert check_mesh(cut).boundaries == 2  # above and below


def test_columns_come_from_the_nearest_vertex_of_the_face() -> None:
    vertices, faces = make_sphere()
    classes = (vertices[:, 2] > 0).astype(np.uint8)
    colours = (vertices * 100 + 120).astype(np.uint8)
    whole = Mesh(vertices, faces, normals=vertices, colours=colours, attributes={"class": classes})
    cut = clip_mesh(whole, Prism(SHAPES["a star with a hole"]))
    assert cut.normals is not None
    assert cut.colours is not None
    assert np.linalg.norm(cut.normals - cut.vertices, axis=1).max() < 0.05
    assert np.abs(cut.colours - (cut.vertices * 100 + 120)).max() < 6
    assert set(cut.attributes["class"]) == {0, 1}


def test_points_in_a_prism_are_found_at_any_height() -> None:
    prism = Prism(SHAPES["a star with a hole"])
    places = np.array(
        [[0.3, 0.0, 1e6], [0.0, 0.0, 0.0], [0.9, 0.0, -5.0], [np.nan, 0, 0], [0.3, 0, np.nan]]
    )
    assert prism.find(places).tolist() == [True, False, True, False, False]
    boxes = np.array([[0.8, -0.1, 0.0], [-0.9, 0.7, 0.0]])
    assert prism.meets(boxes, boxes + 0.2).tolist() == [True, False]
