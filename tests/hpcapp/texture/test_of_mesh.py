"""``simplify`` and ``mend`` give a mesh a texture: of its own vertices, or of photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from painted_scene import find_things, make_mesh, make_shots, paint, to_srgb, write_shots

from hpcapp.cli import hpcapp
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray
from hpcapp.io import read_mesh, write_mesh
from hpcapp.texture.of_mesh import texture_mesh
from hpcapp.texture.texels import cover
from hpccomponent.errors import UsageError

ORIGIN = np.array([5000.0, -300.0, 20.0])


def make_fine(origin: FloatArray) -> Mesh:
    """Return the scene in its paint, far from zero."""
    mesh, _ = make_mesh(80)
    on, things = find_things(mesh.vertices)
    return Mesh(
        mesh.vertices, mesh.faces, origin, colours=np.rint(to_srgb(paint(on, things))).astype("u1")
    )


def test_a_mesh_that_was_not_made_light_keeps_the_colours_of_its_vertices() -> None:
    fine = make_fine(ORIGIN)
    stream = texture_mesh(Mesh(fine.vertices, fine.faces, ORIGIN), fine, 256)
    assert stream.texture is not None
    assert stream.texture.colours is not None
    light = np.concatenate([block.positions for block in stream.vertices()])
    faces = np.concatenate(list(stream.faces()))
    is_ball: list[BoolArray] = []
    off = []
    for texels in cover(stream.texture.places, faces, 256):
        on, things = find_things(texels.blend(light, faces))
        shown = stream.texture.colours.reshape(-1, 3)[texels.cells].astype(float)
        off.append(np.abs(shown - to_srgb(paint(on, things))).max(axis=1))
        is_ball.append(things > 0)  # the ground has 81 vertices
    assert np.median(np.concatenate(off)[np.concatenate(is_ball)]) < 4.0


@pytest.mark.parametrize("verb", [["simplify"], ["mend", "--pieces", "4"]])
def test_photographs_give_colours_to_a_mesh(tmp_path: Path, verb: list[str]) -> None:
    cameras = write_shots(tmp_path / "images", make_shots(4, (160, 120)))
    write_mesh(tmp_path / "fine.ply", make_fine(np.zeros(3)))
    output = tmp_path / "light.obj"
    words = [*verb, str(tmp_path / "fine.ply"), "-o", str(output), "--faces", "2000", "--texture",
             "256", "--images", str(tmp_path / "images"), "--viewpoint", str(cameras)]  # fmt: skip
    done = CliRunner().invoke(hpcapp, words, catch_exceptions=False)
    assert done.exit_code == 0
    assert "in 4 photographs; the rest takes the colours of the vertices" in done.output
    assert (tmp_path / "light_colours.png").is_file()
    assert len(read_mesh(output).faces) <= 2000


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--texture", "256"], "--texture is for a light mesh"),
        (["--faces", "99", "--images", "x"], "--images means nothing without --texture"),
        (["--faces", "99", "--viewpoint", "x"], "--viewpoint means nothing without --images"),
        (["--faces", "99", "--texture", "256", "--images", "x"], "is no folder"),
        (["--faces", "99", "--texture", "256", "--images", "."], "no file says which cameras"),
    ],
)
def test_what_gives_no_texture_is_refused(tmp_path: Path, words: list[str], said: str) -> None:
    write_mesh(tmp_path / "fine.ply", make_fine(np.zeros(3)))
    with pytest.raises(UsageError, match=said):
        CliRunner().invoke(
            hpcapp, ["simplify", str(tmp_path / "fine.ply"), "-o", str(tmp_path / "a.glb"),
                     "--tolerance", "0.1", *words], catch_exceptions=False,
        )  # fmt: skip
    assert [path.name for path in tmp_path.iterdir()] == ["fine.ply"]
