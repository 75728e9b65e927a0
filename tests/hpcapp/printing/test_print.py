"""Prints as files, judged by trimesh and by 3MF's rules; what may be asked, and is refused."""

from __future__ import annotations

import logging
import zipfile
from collections import Counter
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from cut_mesh import ball, extract_shape
from sheets import sweep

import hpcapp as package
from hpcapp.cli import main
from hpcapp.geometry.mesh import Mesh
from hpcapp.io import read_mesh, write_mesh
from hpcapp.io.crs import METRES, UNKNOWN, Crs
from hpcapp.io.meshes.mesh_stream import as_stream
from hpcapp.mending.command import mend
from hpcapp.printing.request import MILLIMETRES, make_printing
from hpccomponent.errors import UsageError

pytest.importorskip("manifold3d")
from hpcapp.printing.prepare import make_print

CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"


def make_figure() -> Mesh:
    """Two balls on one another, the lower one blue, 1.9 tall and 1.4 wide."""
    mesh = extract_shape(
        lambda points: np.minimum(ball(points, (0, 0, -0.2), 0.7), ball(points, (0, 0, 0.6), 0.4))
    )[0]
    is_upper = mesh.vertices[:, 2:] > 0.3
    colours = np.where(is_upper, [[200, 0, 0]], [[0, 0, 200]]).astype(np.uint8)
    return replace(mesh, colours=colours)


@pytest.fixture(scope="module")
def figure(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("figure") / "figure.ply"
    write_mesh(path, replace(as_stream(make_figure()), crs=Crs(None, "m")))
    return path


def run_verb(*words: str | Path) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(map(str, words)))
    return int(ended.value.code or 0)


def run(*words: str | Path) -> None:
    done = CliRunner().invoke(mend, list(map(str, words)), catch_exceptions=False)
    assert done.exit_code == 0, done.output


def check_solid(path: Path) -> trimesh.Trimesh:
    """One body that trimesh takes for a volume, which stands on the bed, in the positive octant."""
    solid = trimesh.load(path, force="mesh")
    assert isinstance(solid, trimesh.Trimesh)
    assert solid.is_volume
    assert solid.body_count == 1
    assert solid.bounds[0].tolist() == pytest.approx([0, 0, 0], abs=1e-6)
    return solid


def test_an_stl_is_as_tall_as_asked(
    figure: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "hpcapp")
    out = tmp_path / "figure.stl"
    run(figure, "-o", out, "--print", "--height", "12cm")
    solid = check_solid(out)
    assert solid.extents[2] == pytest.approx(120.0, abs=1e-4)
    assert solid.area_faces.min() > 0.0
    (line,) = (said for said in caplog.messages if "mm tall" in said)
    assert "120.0 mm tall, scale 1:1" in line
    assert line.endswith("closed, manifold, 1 piece")
    assert f"{solid.volume / 1000:.0f}" in line


def test_a_3mf_has_millimetres_and_keeps_its_rules(figure: Path, tmp_path: Path) -> None:
    out = tmp_path / "figure.3mf"
    run(figure, "-o", out, "--print", "--scale", "1:20")
    model = ElementTree.fromstring(zipfile.ZipFile(out).read("3D/3dmodel.model"))  # noqa: S314
    assert model.get("unit") == "millimeter"
    places = np.array(
        [[float(one.get(axis, "nan")) for axis in "xyz"] for one in model.iter(f"{CORE}vertex")]
    )
    assert np.ptp(places[:, 0]) == pytest.approx(70.0, abs=0.5)
    assert places.min() >= 0.0
    faces = [
        tuple(int(f.get(v, "")) for v in ("v1", "v2", "v3")) for f in model.iter(f"{CORE}triangle")
    ]
    sides = Counter(side for a, b, c in faces for side in ((a, b), (b, c), (c, a)))
    assert set(sides.values()) == {1}  # each once this way, and once back
    assert all((b, a) in sides and a != b for a, b in sides)


def test_colours_stay_where_they_are(figure: Path) -> None:
    made, facts = make_print(read_mesh(figure), Crs(None, "m"), make_printing("1:10"))
    assert made.colours is not None
    # The figure is from -0.9 to 1.0; what is cut off is below.
    is_upper = made.vertices[:, 2] / 100 + 1.0 - facts.sides[2] / 100 > 0.3
    assert (made.colours[is_upper] == [200, 0, 0]).all(axis=1).mean() > 0.97
    assert (made.colours[~is_upper] == [0, 0, 200]).all(axis=1).mean() > 0.97


def test_by_default_it_fits_and_what_is_too_large_is_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
    figure = make_figure()
    # Of 1650 mm: 165 fit into 250, and 330, the next larger ones, do not.
    smaller = replace(figure, vertices=0.868 * figure.vertices)
    assert make_print(smaller, Crs(None, "m"), make_printing())[1].scale == pytest.approx(0.1)
    assert make_print(figure, Crs(None, "mm"), make_printing())[1].scale == 1.0
    facts = make_print(figure, UNKNOWN, make_printing())[1]
    assert facts.scale is None
    assert 90.0 < max(facts.sides) <= 100.0 + 1e-9
    facts = make_print(figure, UNKNOWN, make_printing("1:2", unit="m"))[1]
    assert facts.warnings == (
        "the print is larger than 250 mm, as most printers are: scale='1:10' fits",
    )
    assert f"warning: {facts.warnings[0]}" in caplog.messages


def test_up_is_turned_up_and_heights_get_the_unit_of_the_others() -> None:
    figure = make_figure()
    lying = replace(figure, vertices=figure.vertices[:, [2, 0, 1]])
    sides = make_print(lying, UNKNOWN, make_printing(height=50), "x")[1].sides
    upright = make_print(figure, UNKNOWN, make_printing(height=50), "z")[1].sides
    assert sides == pytest.approx(upright, rel=1e-6)
    feet = replace(figure, vertices=figure.vertices / [1, 1, 0.3048])
    crs = Crs(None, "m", "ft")
    found = make_print(feet, crs, make_printing("1:10"))[1].sides
    assert found == pytest.approx(
        make_print(figure, Crs(None, "m"), make_printing("1:10"))[1].sides, rel=1e-6
    )


def test_a_facade_lies_on_its_back_unless_it_is_asked_to_stand() -> None:
    along = np.linspace(0, 8, 9)
    sheet = sweep(np.stack([along, 0.2 * np.sin(along)], axis=1), 6.0, 7)
    wall = replace(sheet, vertices=sheet.vertices[:, [0, 2, 1]])
    facts = make_print(wall, Crs(None, "m"), make_printing("1:100", wall=3))[1]
    assert facts.kind == "relief"
    assert 5.0 < facts.sides[2] < 8.0
    facts = make_print(wall, Crs(None, "m"), make_printing("1:100", wall=3), "z")[1]
    assert facts.kind == "shell"
    assert facts.sides[2] == pytest.approx(60.0, abs=1e-3)


@pytest.mark.parametrize(("slope", "kind"), [(53.0, "relief"), (65.0, "shell")])
def test_what_faces_up_enough_is_backed_below(slope: float, kind: str) -> None:
    """The heights of its unit normals are .60 and .42."""
    far = 80.0 * np.array([np.cos(np.radians(slope)), np.sin(np.radians(slope))])
    facts = make_print(
        sweep(np.stack([0 * far, far]), 80.0), Crs(None, "mm"), make_printing("1:1"), "z"
    )[1]
    assert facts.kind == kind
    assert facts.sides[2] > 60.0


@pytest.mark.parametrize(("height", "kind"), [(2.4, "relief"), (4.6, "shell")])
def test_a_sheet_that_would_be_thin_when_backed_gets_a_wall(height: float, kind: str) -> None:
    """A field and the wall at its end, behind which is nothing: .032 and .054 of the surface."""
    field = sweep(np.array([[0, 0], [80, 0], [80, height]]), 80.0)
    assert make_print(field, Crs(None, "mm"), make_printing("1:1"))[1].kind == kind


@pytest.mark.parametrize(("height", "warnings"), [(0.3, 1), (0.5, 0)])
def test_what_a_nozzle_cannot_lay_down_is_warned_of(height: float, warnings: int) -> None:
    plate = trimesh.creation.box((80.0, 80.0, height))
    mesh = Mesh(np.array(plate.vertices), np.array(plate.faces))
    facts = make_print(mesh, Crs(None, "mm"), make_printing("1:1"))[1]
    assert ["thinner than 0.4 mm" in said for said in facts.warnings] == [True] * warnings


def test_python_makes_the_same_print(figure: Path, tmp_path: Path) -> None:
    run(figure, "-o", tmp_path / "typed.stl", "--print", "--scale", "1:50")
    package.read_mesh(figure).for_print(scale="1:50").save(tmp_path / "python.stl")
    assert (tmp_path / "typed.stl").read_bytes() == (tmp_path / "python.stl").read_bytes()


def test_a_scan_becomes_a_print(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    scan, out = tmp_path / "scan.ply", tmp_path / "print.stl"
    assert run_verb("simulate", "--shape", "sphere", "--points", "2000", "-o", scan) == 0
    words = ["--print", "--unit", "m", "--scale", "1:20", "--grid", "32"]
    assert run_verb("reconstruct", scan, "-o", out, *words) == 0
    assert "mm tall, scale 1:20" in capfd.readouterr().err
    check_solid(out)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--scale", "1:10"], "means nothing without --print"),
        (["--print", "--scale", "0:1"], "is no scale"),
        (["--print", "--height", "tall"], "is no length"),
        (["--print", "--height", "1mm", "--scale", "1:2"], "exclude each other"),
        (["--print", "--size", "1M"], "exclude each other"),
        (["--print", "--origin", "keep"], "exclude each other"),
        (["--print", "-o", "a.glb"], "no slicer reads it"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(
    figure: Path, tmp_path: Path, words: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for verb in ("mend", "reconstruct"):
        assert run_verb(verb, figure, "-o", tmp_path / "a.stl", *words) == 2
        assert reason in capsys.readouterr().err.replace("\n", " ")
    assert not list(tmp_path.iterdir())


def test_a_scale_needs_a_unit() -> None:
    with pytest.raises(UsageError, match="not known"):
        make_printing("1:10").find_unit(None)
    with pytest.raises(UsageError, match="no length"):
        make_printing().find_unit("degree")
    assert make_printing(unit="in").find_unit("degree") == 25.4
    metres = {name: MILLIMETRES[name] / 1000.0 for name in METRES}
    assert metres == pytest.approx(METRES)


@pytest.mark.parametrize(
    ("suffix", "unit", "said"),
    [
        (".stl", "m", "its m are read as mm"),
        (".stl", None, "no unit is known"),
        (".3mf", None, "no unit is known"),
        (".stl", "mm", ""),
        (".3mf", "m", ""),
        (".ply", None, ""),
    ],
)
def test_metres_that_a_slicer_reads_as_millimetres_are_told(
    tmp_path: Path, suffix: str, unit: str | None, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "hpcapp")
    figure = replace(make_figure(), colours=None)
    write_mesh(tmp_path / f"a{suffix}", replace(as_stream(figure), crs=Crs(None, unit)))
    lines = [line for line in caplog.messages if "to a slicer" in line]
    assert len(lines) == bool(said)
    assert all(said in line and "1.4 x 1.4 x 1.9 mm" in line for line in lines)
