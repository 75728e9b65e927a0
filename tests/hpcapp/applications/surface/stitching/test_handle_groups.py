"""Small handles are cut and small hollows dropped: what is left is closed, and the same mesh."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from directions import random_directions
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from skimage.measure import marching_cubes
from voxels import block, skin

from hpcapp import reconstruct
from hpcapp.applications.surface.cloud.measure import measure_points
from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.extraction.summary import summarize_part
from hpcapp.applications.surface.hierarchical.method import HierarchicalMethod
from hpcapp.applications.surface.resolution.estimates import suited_steps
from hpcapp.applications.surface.stitching import handle_groups
from hpcapp.applications.surface.stitching.handle_groups import (
    GROUP,
    MARGIN,
    Mended,
    group_bricks,
    mend_handles,
)
from hpcapp.applications.surface.stitching.handles import BOX
from hpcapp.applications.surface.stitching.surface import Surface
from hpcapp.applications.surface.stitching.topology import Topology, check_mesh, signed_volume
from hpcapp.applications.surface.tiles.checkpoint import Checkpoint
from hpcapp.geometry.lattice import pack_places, unique_keys, unpack_keys
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray, PointCloud
from hpcapp.lab.simulate.scanner import simulate_scan
from hpcapp.lab.simulate.settings import ScanSettings
from hpcapp.lab.simulate.shapes import SHAPES
from hpcapp.workforce import Workforce


def tell_one(places: FloatArray) -> FloatArray:
    """What points tell that lie about as densely as the corners of voxels."""
    return np.ones(len(places))


def mend(solid: BoolArray) -> tuple[Mesh, Mended, Topology]:
    surface, found = mend_handles(Surface.of_mesh(skin(solid)), tell_one)
    mesh = surface.mesh()
    assert surface.check() == check_mesh(mesh)
    return mesh, found, check_mesh(mesh)


@pytest.mark.parametrize("places", [((20, 20),), ((8, 8), (8, 36), (36, 8))])
def test_bridges_over_narrow_grooves_are_cut(places: tuple[tuple[int, int], ...]) -> None:
    solid = block(2, places)
    mesh, found, topology = mend(solid)
    assert topology.watertight
    assert topology.oriented
    assert topology.genus == 0
    assert (found.cut, found.left, found.hollows) == (len(places), 0, 0)
    # No more is gone than the bridges, or filled than the grooves below them.
    assert abs(signed_volume(mesh) - solid.sum()) < 16 * len(places)


def test_a_tunnel_below_the_skin_is_closed() -> None:
    solid = np.ones((40, 40, 20), np.bool_)
    solid[20:22, 20:26, 17:19] = False
    solid[20:22, [20, 25], 19] = False
    mesh, found, topology = mend(solid)
    assert topology.watertight
    assert topology.genus == 0
    assert (found.cut, found.left) == (1, 0)
    assert abs(signed_volume(mesh) - solid.sum()) < 30


def test_wide_handles_stay_as_they_are() -> None:
    solid = block(16)
    surface = Surface.of_mesh(skin(solid))
    mended, found = mend_handles(surface, tell_one)
    assert mended is surface
    assert (found.cut, found.left, found.hollows) == (0, 0, 0)


def test_handles_that_points_tell_stay_however_coarse_the_faces_are() -> None:
    surface = Surface.of_mesh(skin(block(2)))
    assert mend_handles(surface, tell_one)[1].cut == 1
    mended, found = mend_handles(surface, lambda places: np.full(len(places), 0.25))
    assert mended is surface
    assert (found.cut, found.left, found.hollows) == (0, 0, 0)


@pytest.mark.parametrize("grid", [32, 48, 64])
def test_bores_stay_open_in_a_coarse_grid(grid: int) -> None:
    """Two of the four are eight spacings wide, and three faces or fewer."""
    scan = simulate_scan(SHAPES["bracket"], ScanSettings(points=20_000, noise=0.001))
    made = reconstruct(scan, grid=grid)
    assert check_mesh(Mesh(made.vertices, made.faces)).genus == 4


@pytest.mark.parametrize(("width", "dropped"), [(2, 1), (12, 0)])
def test_small_hollows_are_dropped(width: int, dropped: int) -> None:
    solid = np.ones((24, 24, 24), np.bool_)
    solid[6 : 6 + width, 6 : 6 + width, 6 : 6 + width] = False
    _, found, topology = mend(solid)
    assert found.hollows == dropped
    assert topology.components == 2 - dropped


def test_a_hollow_with_a_handle_is_dropped_whole() -> None:
    solid = np.ones((32, 32, 32), np.bool_)
    solid[14:17, 14:17, 15] = False
    solid[15, 15, 15] = True
    assert check_mesh(skin(solid)).genus == 1
    mesh, found, topology = mend(solid)
    assert (found.cut, found.left, found.hollows) == (0, 0, 1)
    assert (topology.components, topology.genus) == (1, 0)
    assert signed_volume(mesh) == pytest.approx(32**3)


def test_a_second_pass_keeps_patches_of_its_own(tmp_path: Path) -> None:
    """The first part has no handle, and so keeps its name in both passes."""
    solid = block(2, ((8, 8),))
    solid[24:28, 21:29, 4:] = False
    solid[24:28, 24:26, 5] = True
    meshes = skin(np.ones((4, 4, 4), np.bool_)), skin(solid)
    parts = [MeshPart.of_mesh(meshes[0]), MeshPart.of_mesh(meshes[1])]
    parts[1] = replace(parts[1], bricks=parts[1].bricks + 1, vertices=parts[1].vertices + 9.0)
    checkpoint = Checkpoint(str(tmp_path), "job")
    checkpoint.make_folders()
    summaries = [summarize_part(part) for part in parts]
    for name, part, summary in zip("ab", parts, summaries, strict=True):
        checkpoint.store.put(name, (part, summary, np.empty(0, np.int64)))
    surface = Surface(["a", "b"], summaries, np.zeros(3), checkpoint, crumb=0)
    assert surface.check().genus == 2
    with mock.patch.object(handle_groups, "BOX", 0.7 * BOX):
        surface, first = mend_handles(surface, tell_one)
    surface, second = mend_handles(surface, tell_one)
    assert (first.cut, second.cut) == (1, 1)
    assert surface.check() == check_mesh(surface.mesh())
    assert surface.check().watertight
    assert surface.check().genus == 0


@settings(max_examples=12)
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(10, 18), width=st.floats(0.8, 2.0))
def test_whatever_the_handles_a_mesh_stays_closed(seed: int, size: int, width: float) -> None:
    """Level sets of smoothed noise: sponges, of as many handles and hollows as can be."""
    values = gaussian_filter(np.random.default_rng(seed).normal(size=(size,) * 3), width)
    padded = np.pad(values, 1, constant_values=values.min() - 1.0)
    vertices, faces, _, _ = marching_cubes(padded, 0.0)  # type: ignore[no-untyped-call]
    solid = Mesh(vertices.astype(np.float64), faces[:, ::-1].astype(np.int64))
    before = check_mesh(solid)
    assume(before.watertight and before.outward)
    surface, found = mend_handles(Surface.of_mesh(solid), tell_one)
    mesh = surface.mesh()
    after = check_mesh(mesh)
    assert surface.check() == after
    assert after.watertight
    assert after.oriented
    assert before.genus is not None
    assert after.genus == before.genus - found.cut
    assert after.components == before.components - found.hollows


@given(seed=st.integers(0, 2**32 - 1), reach=st.integers(1, 70))
def test_a_group_has_its_bricks_and_those_near_it(seed: int, reach: int) -> None:
    keys = unique_keys(pack_places(np.random.default_rng(seed).integers(0, reach, (300, 3))))
    places = unpack_keys(keys)
    groups = group_bricks(keys)
    corners = np.unique(places // GROUP, axis=0) * GROUP
    assert len(groups) == len(corners)
    for rows, low in zip(groups, corners, strict=True):
        is_near = (places >= low - MARGIN) & (places < low + GROUP + MARGIN)
        np.testing.assert_array_equal(rows, np.flatnonzero(is_near.all(axis=1)))


def spotted_ball(count: int = 12_000) -> PointCloud:
    """A sphere with spots where noise is four spacings: there are handles."""
    rng = np.random.default_rng(0)
    normals = random_directions(count, rng)
    spots = np.array([[0, 0, 1.0], [1, 0, 0], [0, -1, 0], [0.6, 0.8, 0]])
    is_noisy = (normals @ spots.T > np.cos(0.35)).any(axis=1)
    noise = np.where(is_noisy, 0.09, 0.002) * rng.normal(size=count)
    return PointCloud((1.0 + noise[:, None]) * normals, normals)


def test_handles_between_groups_are_cut_as_those_within() -> None:
    """With half the margin they are, too; without one a few are left of 27."""
    arranged = measure_points(spotted_ball())
    method = HierarchicalMethod(96)
    with ThreadPoolExecutor(1) as executor:
        workforce = Workforce(executor, in_process=True)
        partition = method.partition(arranged, workforce)
        surface = method.extract(partition, None, workforce, lambda *_: None)
    handles = surface.check().genus
    assert handles
    assert handles > 20
    left = []
    for margin in (MARGIN, MARGIN // 2, 0):
        with mock.patch.multiple(handle_groups, GROUP=2 * MARGIN, MARGIN=margin):
            steps = partial(suited_steps, partition.plan.refinement)
            left.append(mend_handles(surface, steps)[0].check().genus or 0)
    assert left[0] <= left[1] <= 1 < left[2]


def test_a_hollow_alone_is_dropped() -> None:
    """Inside a ball without any handle, as noise makes them."""
    ball, corners = np.random.default_rng(0).normal(size=(12_000, 3)), np.eye(3)
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    around = np.concatenate([corners, -corners, np.full((1, 3), 0.577), np.full((1, 3), -0.577)])
    normals = np.concatenate([ball, -around])
    cloud = PointCloud(np.concatenate([ball, 0.06 * around]), normals)
    method = HierarchicalMethod(96)
    with ThreadPoolExecutor(1) as executor:
        workforce = Workforce(executor, in_process=True)
        partition = method.partition(measure_points(cloud), workforce)
        surface = method.extract(partition, None, workforce, lambda *_: None)
        assert surface.check().components == 2
        surface = method.close(partition, surface, workforce, lambda *_: None)
    assert partition.mended is not None
    assert (surface.check().components, partition.mended.hollows) == (1, 1)


def test_tiles_and_folders_give_the_same_bits(tmp_path: Path) -> None:
    cloud = spotted_ball()

    def make(checkpoint: Checkpoint | None, tiles: int | None) -> tuple[Mesh, dict[str, object]]:
        arranged = measure_points(cloud)
        method = HierarchicalMethod(96, checkpoint=checkpoint)
        with ThreadPoolExecutor(2) as executor:
            workforce = Workforce(executor, tiles or 1, in_process=tiles is None)
            partition = method.partition(arranged, workforce)
            quadrics = method.fit(partition, workforce, lambda *_: None)
            surface = method.extract(partition, quadrics, workforce, lambda *_: None)
            # Some first, the others in a second pass: its patches stay beside the first ones.
            with mock.patch.object(handle_groups, "BOX", 0.5 * BOX):
                surface = method.close(partition, surface, workforce, lambda *_: None)
            surface, more = mend_handles(surface, tell_one)
            assert more.cut
            names = [part for part in surface.parts if isinstance(part, str)]
            assert len(set(names)) == len(names)
            is_kept = checkpoint is not None
            assert all(isinstance(part, MeshPart) != is_kept for part in surface.parts)
            mesh = surface.mesh()
            assert surface.check() == check_mesh(mesh)
            assert len(np.unique(mesh.faces)) == len(mesh.vertices)
            return mesh, method.facts(partition) | {"more": more.cut}

    whole, facts = make(None, None)
    assert facts["handles_cut"]
    checkpoint = Checkpoint(str(tmp_path), "job")
    checkpoint.make_folders()
    for place, tiles in ((None, 2), (checkpoint, 8)):
        mesh, found = make(place, tiles)
        assert mesh.vertices.tobytes() == whole.vertices.tobytes()
        assert mesh.faces.tobytes() == whole.faces.tobytes()
        assert found == facts | {"tiles": tiles}
