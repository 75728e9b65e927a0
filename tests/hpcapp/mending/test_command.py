"""The command ``mend`` and `Mesh.mend`: the order of the steps, and what they refuse."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from cut_mesh import ball, extract_shape
from verbs import run_verb

import hpcapp as package
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.io import find_mesh_crs, read_mesh, write_mesh
from hpcapp.io.crs import Crs
from hpcapp.io.meshes.mesh_stream import as_stream
from hpcapp.mending.command import mend
from hpcapp.mending.holes import fill_holes
from hpcapp.mending.pieces import keep_faces
from hpccomponent.cli.option_names import speaking_flags
from hpccomponent.errors import InputError, UsageError

run = partial(run_verb, mend)


def make_balls() -> Mesh:
    """A ball of radius 0.6 with a hole on top, and one of 0.15 with one, too."""

    def shape(points: FloatArray) -> FloatArray:
        return np.minimum(ball(points, (-0.2, 0, 0), 0.6), ball(points, (0.65, 0, 0), 0.15))

    mesh = extract_shape(shape)[0]
    right = mesh.vertices[:, 0] > 0.45
    height = mesh.vertices[mesh.faces][:, :, 2].max(axis=1)
    stays = height < np.where(right[mesh.faces[:, 0]], 0.1, 0.5)
    colours = np.where(right[:, None], 200, 10).astype(np.uint8) * np.ones(3, np.uint8)
    return keep_faces(Mesh(mesh.vertices, mesh.faces, colours=colours), stays)


@pytest.fixture
def holed(tmp_path: Path) -> Path:
    path = tmp_path / "holed.ply"
    write_mesh(path, replace(as_stream(make_balls()), crs=Crs("EPSG:25832", "m")))
    return path


def test_holes_are_filled_first(
    holed: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "hpcapp")
    out = tmp_path / "whole.ply"
    run(holed, "-o", out, "--fill-holes", "2", "--pieces", "1")
    assert "filled 2 holes up to 2" in caplog.messages
    assert "dropped 1 of 2 pieces, 5.7 % of the area" in caplog.messages
    assert caplog.messages[-1].endswith("faces, watertight, 1 piece")
    whole = read_mesh(out)
    assert check_mesh(whole).watertight
    assert whole.colours is not None
    assert (whole.colours == 10).all()
    assert find_mesh_crs(out) == Crs("EPSG:25832", "m")


def test_the_mesh_is_cut_after_that_and_then_simplified(holed: Path, tmp_path: Path) -> None:
    out = tmp_path / "cut.ply"
    run(holed, "-o", out, "--fill-holes", "2", "--box", "-1,-1,0.2,1,1,1", "--faces", "200")
    part = read_mesh(out)
    assert 100 < len(part.faces) <= 200
    assert part.vertices[:, 2].min() == pytest.approx(0.2, abs=2e-3)
    assert part.vertices[:, 2].max() > 0.58
    assert check_mesh(part).boundaries == 1


def test_pieces_are_chosen_from_what_is_within(holed: Path, tmp_path: Path) -> None:
    """There the small ball is the largest piece."""
    out = tmp_path / "cut.ply"
    run(holed, "-o", out, "--pieces", "1", "--around", "0.65,0,0,0.3")
    ends = read_mesh(out)
    assert check_mesh(ends).components == 1
    assert np.linalg.norm(ends.vertices - (0.65, 0, 0), axis=1).max() < 0.2


@pytest.mark.parametrize(("edges", "filled"), [(0.9, 0), (1.1, 1)])
def test_a_hole_is_measured_in_edges_too(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, edges: float, filled: int
) -> None:
    """Of a lattice one cell is missing: its diagonal, in its own edge, the median one."""
    caplog.set_level(logging.INFO, "hpcapp")
    u, v = np.meshgrid(np.arange(6.0), np.arange(6.0), indexing="ij")
    places = 7.0 * np.stack([u, v, np.zeros_like(u)], axis=-1).reshape(-1, 3)
    corner = np.delete((6 * u + v)[:-1, :-1].astype(np.int64).ravel(), 12)
    faces = [corner, corner + 6, corner + 1], [corner + 1, corner + 6, corner + 7]
    sheet = Mesh(places, np.concatenate([np.stack(half, axis=1) for half in faces]))
    write_mesh(tmp_path / "sheet.ply", sheet)
    words = "--fill-holes", f"{edges * np.sqrt(2.0)}s"
    run(tmp_path / "sheet.ply", "-o", tmp_path / "whole.ply", *words)
    assert len(read_mesh(tmp_path / "whole.ply").faces) == 48 + 2 * filled
    told = f"filled {filled} hole{'s' * (not filled)} up to "
    assert any(line.startswith(told) for line in caplog.messages)


def test_who_waits_is_told_how_far_it_has_come() -> None:
    told: list[tuple[int, int]] = []
    mesh = make_balls()
    fill_holes(mesh, 2.0, lambda done, total: told.append((done, total)))
    assert len(told) == 2
    assert 0 < told[0][0] < told[0][1] == told[1][0] == told[1][1]


def test_any_format_and_what_is_up(holed: Path, tmp_path: Path) -> None:
    run(holed, "-o", tmp_path / "turned.glb", "--up", "y")
    turned = read_mesh(tmp_path / "turned.glb")
    assert turned.colours is not None
    run(tmp_path / "turned.glb", "-o", tmp_path / "back.obj", "--pieces", "2")
    assert len(read_mesh(tmp_path / "back.obj").faces) == len(read_mesh(holed).faces)


def test_a_small_ball_stays_and_a_crumb_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "hpcapp")
    mesh, corner = make_balls(), np.array([[0.0, 0, 0.9], [0.05, 0, 0.9], [0, 0.05, 0.9]])
    faces = np.concatenate([mesh.faces, len(mesh.vertices) + np.array([[0, 1, 2]])])
    write_mesh(tmp_path / "crumb.off", Mesh(np.concatenate([mesh.vertices, corner]), faces))
    with speaking_flags():
        run(tmp_path / "crumb.off", "-o", tmp_path / "out.ply", "--fill-holes", "2")
    line = "1 of 3 pieces is small, 0.1 % of the area: --pieces 2 drops it"
    assert caplog.messages.count(line) == 1


def test_heights_of_another_unit_are_cut_as_they_are(tmp_path: Path) -> None:
    """x and y in feet and z in metres: a ball of feet."""
    mesh = extract_shape(lambda points: ball(points, (0.0, 0.0, 0.0), 0.6))[0]
    scales = np.array([1.0, 1.0, 0.3048])
    survey = Mesh(mesh.vertices * scales, mesh.faces)
    crs = Crs("EPSG:2229", "ft", "m")
    write_mesh(tmp_path / "feet.ply", replace(as_stream(survey), crs=crs))
    place = f"0,0,{0.6 * 0.3048},0.4"
    run(tmp_path / "feet.ply", "-o", tmp_path / "top.ply", "--around", place)
    top = read_mesh(tmp_path / "top.ply")
    arms = (top.vertices + top.origin) / scales - (0, 0, 0.6)
    assert np.linalg.norm(arms, axis=1).max() == pytest.approx(0.4, abs=1e-5)


def test_bad_input_is_one_line_and_leaves_nothing(holed: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.ply"
    with pytest.raises(UsageError, match="nothing to mend"):
        run(holed, "-o", out)
    with pytest.raises(InputError, match="no surface in the box from 5 5 5 to 6 6 6") as found:
        run(holed, "-o", out, "--box", "5,5,5,6,6,6")
    assert "the mesh lies from -0.8" in found.value.advice
    with pytest.raises(UsageError, match="no piece of the mesh is as large as 99"):
        run(holed, "-o", out, "--smallest", "99")
    text = "OFF\n3 {} 0\n0 0 0\n1 0 0\n0 1 {}\n"
    (tmp_path / "nan.off").write_text(text.format(1, "nan") + "3 0 1 2\n")
    with pytest.raises(InputError, match="vertex 2 of the mesh is NaN or infinite"):
        run(tmp_path / "nan.off", "-o", out, "--fill-holes", "1")
    (tmp_path / "bare.off").write_text(text.format(0, "0"))
    with pytest.raises(InputError, match="the mesh has no faces"):
        run(tmp_path / "bare.off", "-o", out, "--fill-holes", "1")
    assert not out.exists()


def test_from_python(holed: Path) -> None:
    mesh = package.read_mesh(holed)
    whole = mesh.mend(fill_holes=2.0, pieces=1)
    assert whole.is_watertight
    assert whole.volume == pytest.approx(4.0 / 3.0 * np.pi * 0.6**3, rel=0.01)
    half = mesh.mend(box=(-1.0, -1.0, -1.0, 1.0, 1.0, 0.0))
    assert half.bounds[1][2] == 0.0
    wedge = mesh.mend(polygon="POLYGON((0 -1, 1 -1, 1 1, 0 1, 0 -1))")
    assert wedge.bounds[0][0] == pytest.approx(0.0, abs=1e-6)
    assert wedge.bounds[1][0] == pytest.approx(mesh.bounds[1][0])
    with pytest.raises(UsageError, match="nothing to mend"):
        mesh.mend()
    assert mesh.mend(fill_holes="200s").is_watertight
    for bad in (-1.0, 0.0, "auto", "nan", "s"):
        with pytest.raises(UsageError, match=f"fill_holes is '{bad}'"):
            mesh.mend(fill_holes=bad)
