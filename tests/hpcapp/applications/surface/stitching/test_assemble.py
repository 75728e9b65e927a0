"""The mesh of parts in every way out: the bytes are those of the whole mesh."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cut_mesh import SHAPES, cut_mesh, cuts, drop_small_components, extract_shape
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.extraction.summary import summarize_part
from hpcapp.applications.surface.stitching import assemble as welded
from hpcapp.applications.surface.stitching.plan import StitchingPlan, plan_stitching
from hpcapp.applications.surface.stitching.shared_ply import write_part
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.io import read_mesh, write_mesh
from hpcapp.io.meshes.tiles import write_tiles
from hpcapp.io.ply.format import shared_ply

Weld = tuple[StitchingPlan, list[MeshPart], Mesh]

extracted = cache(extract_shape)
ORIGINS = {"near": np.zeros(3), "far": np.array([4.5e5, 0.0, -12.0])}


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(welded, "_ROWS_AT_ONCE", 700)


@st.composite
def welds(draw: st.DrawFn) -> Weld:
    mesh, of_vertex, of_face = extracted(SHAPES[draw(st.sampled_from(sorted(SHAPES)))])
    parts = cut_mesh(mesh, of_vertex, of_face, *draw(cuts(of_vertex, of_face)))
    origin = ORIGINS[draw(st.sampled_from(sorted(ORIGINS)))]
    whole = drop_small_components(mesh)
    plan = plan_stitching([summarize_part(part) for part in parts])
    return plan, parts, Mesh(whole.vertices, whole.faces, origin)


few = settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".stl", ".glb", ".vtp"])
@few
@given(drawn=welds())
def test_every_format_is_streamed_as_the_whole_is_written(
    tmp_path: Path, suffix: str, drawn: Weld
) -> None:
    plan, parts, whole = drawn
    write_mesh(tmp_path / f"whole{suffix}", whole)
    stream = welded.stream_mesh(plan, parts.__getitem__, whole.origin)
    write_mesh(tmp_path / f"parts{suffix}", stream)
    assert (tmp_path / f"parts{suffix}").read_bytes() == (tmp_path / f"whole{suffix}").read_bytes()


@few
@given(drawn=welds(), seed=st.integers(0, 99))
def test_workers_write_their_bricks_into_one_file(tmp_path: Path, drawn: Weld, seed: int) -> None:
    plan, parts, whole = drawn
    write_mesh(tmp_path / "whole.ply", whole)
    counts = (plan.vertex_count, plan.face_count)
    with shared_ply(tmp_path / "parts.ply", counts, whole.origin, plan.box) as shared:
        for index in np.random.default_rng(seed).permutation(len(parts)).tolist():
            places = plan.places(index)
            write_part(parts[index], places, shared)
    assert (tmp_path / "parts.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()


@few
@given(drawn=welds())
def test_tiles_are_the_faces_of_their_parts_and_meet_exactly(
    drawn: Weld,
) -> None:
    plan, parts, whole = drawn
    triangles = []
    for index, tile in welded.stream_tiles(plan, parts.__getitem__, whole.origin):
        assert len(parts[index].faces)
        vertices, faces = next(tile.vertices()).positions, next(tile.faces())
        assert len(np.unique(faces)) == len(vertices) == tile.vertex_count
        triangles.append(vertices[faces])
    together = np.concatenate(triangles)
    expected = whole.vertices[whole.faces]
    assert sorted(map(bytes, together)) == sorted(map(bytes, expected))


def torus_in_two() -> tuple[Mesh, list[MeshPart], StitchingPlan]:
    mesh, of_vertex, of_face = extracted(SHAPES["torus"])
    keys = np.unique(np.concatenate([of_vertex, of_face])).tolist()
    parts = cut_mesh(mesh, of_vertex, of_face, {k: int(k > keys[len(keys) // 2]) for k in keys})
    return mesh, parts, plan_stitching([summarize_part(part) for part in parts])


def test_blocks_are_bounded_and_mapped_parts_do(tmp_path: Path) -> None:
    mesh, parts, plan = torus_in_two()
    for index, part in enumerate(parts):
        np.save(tmp_path / f"{index}.npy", part.vertices)

    def load(index: int) -> MeshPart:
        mapped = np.load(tmp_path / f"{index}.npy", mmap_mode="r")
        return replace(parts[index], vertices=mapped)

    blocks = list(welded.stream_mesh(plan, load, np.zeros(3)).vertices())
    assert max(map(len, blocks)) < 1000
    assert (
        np.concatenate([block.positions for block in blocks]).tobytes() == mesh.vertices.tobytes()
    )


def test_a_shared_file_that_is_not_finished_leaves_nothing(tmp_path: Path) -> None:
    _, _, plan = torus_in_two()
    with (
        pytest.raises(RuntimeError),
        shared_ply(tmp_path / "mesh.ply", (5, 5), np.zeros(3), plan.box),
    ):
        raise RuntimeError
    assert not list(tmp_path.iterdir())


def test_a_folder_of_tiles_holds_the_mesh(tmp_path: Path) -> None:
    mesh, parts, plan = torus_in_two()
    write_mesh(tmp_path / "mesh.ply", mesh)
    tiles = welded.stream_tiles(plan, parts.__getitem__, mesh.origin)
    write_tiles(tmp_path / "mesh.tiles", tiles)
    names = sorted(path.name for path in (tmp_path / "mesh.tiles").iterdir())
    assert names == ["tile-0000.ply", "tile-0001.ply"]
    found = [read_mesh(tmp_path / "mesh.tiles" / name) for name in names]
    corners = np.concatenate([tile.vertices[tile.faces] for tile in found]).reshape(-1, 3)
    vertices, faces = np.unique(corners, axis=0, return_inverse=True)
    assert check_mesh(Mesh(vertices, faces.reshape(-1, 3))) == check_mesh(
        read_mesh(tmp_path / "mesh.ply")
    )
