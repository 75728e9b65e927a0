"""Meshes cut into parts by their bricks, as tiles would give them: for the tests of the weld."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.stitching.plan import find_large
from hpcapp.geometry.lattice import pack_places, unpack_keys
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.kernels import label_components
from hpcapp.kernels.portable.surface.bricks import grow_bricks
from hpcapp.kernels.portable.surface.marching_cubes import extract_surface
from hpcapp.kernels.types.grid import BRICK, OWN, BrickKinds, Grid

SMALL, CRUMB = (0.75, 0.75, 0.75), (13 / 24, 12 / 24, 5 / 24)
GRID = Grid(np.array([-1.0, -1.0, -1.0]), 1 / 24, (6, 6, 6))


def extract_shape(
    shape: Callable[[FloatArray], FloatArray], grid: Grid = GRID
) -> tuple[Mesh, IntArray, IntArray]:
    """Extract an analytic shape; return the mesh, and the bricks of its vertices and faces."""
    nodes = np.stack(np.meshgrid(*[np.arange(BRICK + 1)] * 3, indexing="ij"), axis=-1)

    def evaluate(bricks: IntArray) -> NDArray[np.float32]:
        points = grid.origin + grid.step * (BRICK * bricks[:, None, None, None] + nodes)
        values = shape(points).astype(np.float32)
        return np.where(values == 0.0, np.float32(1e-6), values)

    every = BrickKinds(np.zeros(3, np.int64), np.full(grid.bricks, OWN, np.uint8))
    bricks, values, *_ = grow_bricks(evaluate, every, grid.bricks)
    found = extract_surface(grid, bricks, values)
    mesh = Mesh(found.vertices, found.faces)
    cells = (mesh.vertices - grid.origin) / grid.step
    of_vertex = np.floor(cells + 1e-4).astype(np.int64)
    of_face = np.floor(cells[mesh.faces].mean(axis=1)).astype(np.int64)
    return mesh, pack_places(of_vertex // BRICK), pack_places(of_face // BRICK)


def torus(points: FloatArray) -> FloatArray:
    x, y, z = np.moveaxis(points, -1, 0)
    values: FloatArray = np.hypot(np.hypot(x, y) - 0.55, z) - 0.21
    return values


def ball(points: FloatArray, center: tuple[float, float, float], radius: float) -> FloatArray:
    values: FloatArray = np.linalg.norm(points - center, axis=-1) - radius
    return values


def large_and_small(points: FloatArray) -> FloatArray:
    """Two spheres, of which the second is dropped."""
    return np.minimum(ball(points, (0, 0, 0), 0.6), ball(points, SMALL, 0.03))


def crumb_in_brick(points: FloatArray) -> FloatArray:
    """A large sphere, and a crumb, to be dropped, in a brick that the sphere passes through."""
    crumb = ball(points, CRUMB, 0.03)
    return np.minimum(ball(points, (0.1, 0, 0), 0.62), crumb)


def twins(points: FloatArray) -> FloatArray:
    """Two equal tori and a sphere between them: a tie, and unlike genus."""
    up = np.array([0.0, 0.0, 0.5])
    rings = np.minimum(torus(points + up), torus(points - up))
    return np.minimum(rings, ball(points, (0, 0, 0), 0.08))


SHAPES = {s.__name__: s for s in (torus, large_and_small, crumb_in_brick, twins)}


def spread_mesh(mesh: Mesh, count: int, rng: np.random.Generator) -> tuple[IntArray, IntArray]:
    """Give the vertices and faces of any mesh bricks, without regard to where they are."""
    keys = np.unique(pack_places(rng.integers(0, 40, (count, 3))))
    of_vertex = np.sort(rng.choice(keys, len(mesh.vertices)))
    return of_vertex, np.sort(rng.choice(keys, len(mesh.faces)))


def cut_mesh(
    mesh: Mesh,
    of_vertex: IntArray,
    of_face: IntArray,
    owners: dict[int, int],
    guests: Sequence[tuple[int, int]] = (),
) -> list[MeshPart]:
    """Cut a mesh.

    ``of_vertex`` and ``of_face`` are keys of bricks, rising. ``owners`` names the part of each
    brick, -1 for one that only guests have; ``guests`` are further pairs (part, brick).
    """
    count = max([0, *owners.values(), *(part for part, _ in guests)]) + 1
    return [
        _part(
            mesh,
            of_vertex,
            of_face,
            {k for k, part in owners.items() if part == index},
            {k for part, k in guests if part == index and owners[k] != index},
        )
        for index in range(count)
    ]


def _part(
    mesh: Mesh, of_vertex: IntArray, of_face: IntArray, own: set[int], guests: set[int]
) -> MeshPart:
    bricks = np.array(sorted(own | guests), np.int64)
    first = np.searchsorted(of_vertex, of_vertex)  # the first vertex of each one's brick
    mine = np.isin(of_vertex, bricks)
    faces = mesh.faces[np.isin(of_face, bricks)]
    used = np.zeros(len(mesh.vertices), bool)
    used[faces.ravel()] = True
    foreign = np.flatnonzero(used & ~mine)
    rows = np.full(len(mesh.vertices), 0)
    rows[mine] = np.arange(mine.sum())
    rows[foreign] = ~np.arange(len(foreign))
    return MeshPart(
        bricks,
        np.array([key in guests for key in bricks], bool),
        np.array([(of_vertex == key).sum() for key in bricks], np.int32),
        np.array([(of_face == key).sum() for key in bricks], np.int32),
        mesh.vertices[mine],
        rows[faces].astype(np.int32),
        of_vertex[foreign],
        (foreign - first[foreign]).astype(np.int32),
        is_supported(mesh.vertices[mine]),
    )


@st.composite
def cuts(
    draw: st.DrawFn, of_vertex: IntArray, of_face: IntArray, most: int = 6
) -> tuple[dict[int, int], list[tuple[int, int]]]:
    """Draw owners and guests for the bricks of a mesh."""
    keys = sorted({*of_vertex.tolist(), *of_face.tolist()})
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(1, most))
    in_blocks = draw(st.booleans())
    places = unpack_keys(np.array(keys, np.int64)) // 2
    chosen = (
        places @ rng.integers(1, 9, 3) if in_blocks else rng.integers(0, 99, len(keys))
    ) % count
    owners = dict(zip(keys, chosen.tolist(), strict=True))
    guests = []
    for key in rng.choice(keys, draw(st.integers(0, min(8, len(keys)))), replace=False):
        hosts = rng.choice(count, rng.integers(1, count + 1), replace=False)
        guests += [(int(host), int(key)) for host in hosts]
        if rng.integers(2):
            owners[int(key)] = -1  # it is in no part but as a guest
    return owners, guests


def is_supported(vertices: FloatArray) -> BoolArray:
    """Tell which vertices have points: all but those of the small sphere and of the crumb."""
    small = [ball(vertices, center, 0.05) < 0.0 for center in (SMALL, CRUMB)]
    return ~np.logical_or(*small)


def drop_small_components(mesh: Mesh) -> Mesh:
    """Drop components with few faces and no points beside the largest one.

    Returns
    -------
    Mesh
        Without vertices that no face uses, if anything was dropped.
    """
    if not len(mesh.faces):
        return mesh
    count = len(mesh.vertices)
    pieces, component = label_components(mesh.faces, count)
    if pieces == 1:
        return mesh
    counts = np.bincount(component[mesh.faces[:, 0]], minlength=pieces)
    supported = component[is_supported(mesh.vertices)]
    kept = find_large(counts, np.bincount(supported, minlength=pieces))
    if kept.all():
        return mesh
    faces = mesh.faces[kept[component[mesh.faces[:, 0]]]]
    used = np.zeros(count, np.bool_)
    used[faces.reshape(-1)] = True
    renumbered = np.cumsum(used) - 1
    return Mesh(mesh.vertices[used], renumbered[faces], mesh.origin)
