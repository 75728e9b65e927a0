"""What is closed and manifold stays so, on each way that leads to fewer faces."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from closed_meshes import closed_meshes, is_closed
from hypothesis import given, settings
from hypothesis import strategies as st

from hpcapp.geometry.mesh import Mesh
from hpcapp.io import read_mesh
from hpcapp.io.meshes.tileset import write_tileset
from hpcapp.simplification.mesh import simplify_mesh
from hpcapp.simplification.stream import simplify_stream
from hpcapp.simplification.target import Target

targets = st.one_of(
    st.builds(Target, st.integers(4, 400)),
    st.builds(Target, st.none(), st.sampled_from([1e-6, 0.1, 10.0])),
)


@given(closed_meshes, targets)
@settings(deadline=None, max_examples=40)
def test_a_closed_mesh_stays_closed(mesh: Mesh, target: Target) -> None:
    assert is_closed(mesh)
    assert is_closed(simplify_mesh(mesh, target))


@given(closed_meshes, targets, st.integers(1, 300))
@settings(deadline=None, max_examples=40)
def test_a_closed_mesh_in_runs_stays_closed(mesh: Mesh, target: Target, run_faces: int) -> None:
    assert is_closed(simplify_stream(mesh, target, run_faces))


@given(closed_meshes, st.integers(20, 200))
@settings(deadline=None, max_examples=20)
def test_the_coarsest_of_nested_tiles_is_closed(mesh: Mesh, tile_faces: int) -> None:
    with TemporaryDirectory() as folder:
        tileset = Path(folder) / "mesh.3dtiles"
        write_tileset(tileset, mesh, tile_faces)
        assert is_closed(read_mesh(tileset / "0.glb"))
