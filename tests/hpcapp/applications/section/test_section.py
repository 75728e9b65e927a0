"""Sections of solids and of ground whose outlines are known, on a map."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import trimesh
from ezdxf.filemanagement import readfile

import hpcapp
from hpcapp.applications.section.cut import cut_mesh, make_sections
from hpcapp.applications.section.planes import plan_planes
from hpcapp.applications.section.sections import Section
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import write_mesh, write_points
from hpcapp.io.crs import Crs
from hpcapp.io.placement import note_origin

Run = Callable[..., tuple[int, str, str]]

PLACE = np.array([512_000.0, 5_403_000.0, 300.0])
INNER, OUTER = 0.9, 1.0


def place(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(solid.vertices), np.array(solid.faces, dtype=np.int64), PLACE)


def make_pipe() -> Mesh:
    """Return an upright pipe 4 m long; its middle is `PLACE`."""
    return place(trimesh.creation.annulus(INNER, OUTER, 4.0, sections=360))


def lay_road() -> Mesh:
    """Return a road along x, 10 m wide between slopes of 3 in 10, which rises by 5 in 100."""
    y, x = np.indices((81, 161)) * 0.5
    z = 0.05 * x + 0.3 * np.maximum(np.abs(y - 20.0) - 5.0, 0.0)
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, d), (a, d, c))]
    return Mesh(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), np.concatenate(faces), PLACE)


def cut(mesh: Mesh, *planes: str, step: float | None = None) -> list[Section]:
    low, high = (end(mesh.vertices, axis=0) + mesh.origin for end in (np.min, np.max))
    return [cut_mesh(mesh, one) for one in plan_planes(planes, step, low, high)]


@pytest.fixture
def road(tmp_path: Path) -> Path:
    write_mesh(tmp_path / "road.ply", lay_road())
    note_origin(tmp_path / "road.ply", np.zeros(3), Crs("EPSG:25832", "m"), holds_crs=False)
    return tmp_path / "road.ply"


@pytest.fixture
def axis(tmp_path: Path) -> Path:
    corners = [[512_010.0, 5_403_020.0], [512_040.0, 5_403_020.0], [512_060.0, 5_403_020.0]]
    line = {"type": "LineString", "coordinates": corners}
    feature = {"type": "Feature", "properties": {"name": "A 7"}, "geometry": line}
    (tmp_path / "axis.geojson").write_text(json.dumps(feature))
    return tmp_path / "axis.geojson"


def test_a_pipe_is_cut_into_two_rings() -> None:
    level, oblique = cut(make_pipe(), "z=300.3", "512000,5403000,300,1,0,1")
    outer, inner = sorted(level.outlines, key=lambda one: -one.area)
    for ring, radius in ((outer, OUTER), (inner, INNER)):
        assert ring.is_closed
        assert np.array_equal(ring.points[0], ring.points[-1])
        away = np.linalg.norm((ring.points - PLACE)[:, :2], axis=1)
        assert away.max() == pytest.approx(radius, abs=1e-8)
        assert away.min() == pytest.approx(radius, abs=1e-4)  # in the middle of a chord
        assert np.abs(ring.points[:, 2] - 300.3).max() < 1e-9
        assert ring.length == pytest.approx(2.0 * np.pi * radius, rel=1e-4)
    assert outer.area == pytest.approx(np.pi * OUTER**2, rel=1e-3)
    assert inner.area == pytest.approx(-np.pi * INNER**2, rel=1e-3)
    assert level.area == pytest.approx(np.pi * (OUTER**2 - INNER**2), rel=1e-3)
    assert oblique.area == pytest.approx(2.0**0.5 * level.area, rel=1e-3)


def test_drawings_of_upright_planes_have_the_coordinates_of_the_map() -> None:
    for plane, axes in (("x=512000", (1, 2)), ("y=5403000", (0, 2)), ("z=300", (0, 1))):
        (section,) = cut(make_pipe(), plane)
        assert len(section.outlines) == section.closed == 2
        for outline in section.outlines:
            assert np.allclose(outline.flat, outline.points[:, axes], rtol=0.0, atol=1e-8)


def test_planes_at_each_multiple_of_a_step() -> None:
    sections = cut(make_pipe(), "z", step=0.5)
    assert [one.name for one in sections[:2]] == ["z=298", "z=298.5"]
    assert len(sections) == 9
    # what lies in a plane has the outline of what is behind: at the lower end there is nothing
    assert [len(one.outlines) for one in sections] == [0, *(2,) * 8]


@pytest.mark.parametrize("plane", ["0,0,0,1,1,0", "0,0,0,1,1,1", "x=0", "z=0.5", "0.5,0,0,1,0,1"])
def test_planes_through_corners_and_edges_leave_no_gap(plane: str) -> None:
    box = trimesh.creation.box()
    (section,) = cut(Mesh(np.array(box.vertices), np.array(box.faces, dtype=np.int64)), plane)
    (outline,) = section.outlines
    assert outline.is_closed
    area = {"0,0,0,1,1,0": 2.0**0.5, "0,0,0,1,1,1": 0.75 * 3.0**0.5, "0.5,0,0,1,0,1": 0.5**0.5}
    assert section.area == pytest.approx(area.get(plane, 1.0))
    assert (np.linalg.norm(np.diff(outline.points, axis=0), axis=1) > 0.0).all()


def test_sections_across_a_road_are_square_to_it_and_as_wide_as_asked(road: Path) -> None:
    line = "LINESTRING (512010 5403020, 512040 5403020, 512060 5403020)"
    sections = hpcapp.section(road, along=line, step=20.0, width=16.0)
    assert [one.station for one in sections] == [0.0, 20.0, 40.0]
    for station, section in zip((0.0, 20.0, 40.0), sections, strict=True):
        (outline,) = section.outlines
        assert not outline.is_closed
        x, y, z = (outline.points - PLACE).T
        assert np.abs(x - 10.0 - station).max() < 1e-8
        offset, height = outline.flat.T
        assert np.allclose(offset, 20.0 - y, rtol=0.0, atol=1e-8)  # to the right is to the south
        assert [offset.min(), offset.max()] == pytest.approx([-8.0, 8.0])
        true = 0.05 * x + 0.3 * np.maximum(np.abs(offset) - 5.0, 0.0)
        assert np.abs(z - true).max() < 1e-8
        assert np.abs(height - 300.0 - true).max() < 1e-8


def test_a_section_halves_the_angle_at_a_corner_and_the_end_of_a_line_has_one(road: Path) -> None:
    line = "LINESTRING (512010 5403020, 512030 5403020, 512030 5403040)"
    corner = hpcapp.section(road, along=line, step=20.0)[1].outlines[0]
    x, y, _ = (corner.points - PLACE).T
    assert np.abs((x - 30.0) + (y - 20.0)).max() < 1e-8
    short = "LINESTRING (512010 5403020, 512010.3 5403020)"  # .3 / .1 is less than 3
    assert [one.name for one in hpcapp.section(road, along=short, step=0.1)][-1] == "0.3"


def test_the_profile_along_a_bent_line_is_one_outline(road: Path) -> None:
    line = "LINESTRING (512010 5403020, 512040 5403020, 512040 5403032, 512064 5403014)"
    ((outline,),) = [one.outlines for one in hpcapp.section(road, along=line)]
    station, height = outline.flat.T
    assert [station.min(), station.max()] == pytest.approx([0.0, 72.0])
    assert (np.diff(station) > -1e-9).all() or (np.diff(station) < 1e-9).all()
    x, y, z = (outline.points - PLACE).T
    assert np.abs(z - 0.05 * x - 0.3 * np.maximum(np.abs(y - 20.0) - 5.0, 0.0)).max() < 1e-8
    assert np.abs(height - z - 300.0).max() < 1e-8


def test_a_drawing_is_in_place(run: Run, road: Path, axis: Path, tmp_path: Path) -> None:
    words = ("section", str(road), "--along", str(axis), "--step", "25", "--width", "8")
    code, table, said = run(*words, "-o", "cross.dxf")
    assert code == 0
    assert "3 sections; 3 outlines, 0 of them closed" in said
    assert table.splitlines()[2].split() == ["A", "7", "25", "1", "0", "8.00", "m", "0", "m²"][:9]
    drawing = readfile(tmp_path / "cross.dxf")
    assert drawing.units == 6  # metres
    lines: list[Any] = list(drawing.modelspace())
    assert [one.dxf.layer for one in lines] == ["A 7 0", "A 7 25", "A 7 50"]
    ends = np.array([list(lines[1].points())[k] for k in (0, -1)])
    assert np.abs(ends[:, 0] - 512_035.0).max() < 1e-8
    assert sorted(ends[:, 1].tolist()) == pytest.approx([5_403_016.0, 5_403_024.0])

    assert run(*words, "-o", "cross.geojson")[0] == 0
    found = json.loads((tmp_path / "cross.geojson").read_text())
    assert found["crs"]["properties"]["name"] == "urn:ogc:def:crs:EPSG::25832"
    told = found["features"][1]["properties"]
    assert (told["line"], told["station"], told["closed"]) == ("A 7", 25.0, False)
    assert (
        np.abs(np.array(found["features"][1]["geometry"]["coordinates"])[:, 0] - 512_035.0).max()
        < 1e-8
    )
    axis.write_text(axis.read_text().replace("A 7", "frames"))  # as another layer is called
    assert run(*words[:4], "-o", "profile.dxf", "--flat")[0] == 0


def test_flat_drawings_lie_side_by_side(run: Run, tmp_path: Path) -> None:
    write_mesh(tmp_path / "pipe.ply", make_pipe())
    words = ("section", "pipe.ply", "--plane", "z=300", "--plane", "y=5403000")
    assert run(*words, "-o", "flat.dxf", "--flat")[0] == 0
    space: Any = readfile(tmp_path / "flat.dxf").modelspace()
    rings = [one for one in space.query("LWPOLYLINE") if one.dxf.layer == "z 300"]
    spans = [np.ptp(np.array(one.get_points("xy")), axis=0).max() for one in rings]
    assert [one.closed for one in rings] == [True, True]
    assert sorted(spans) == pytest.approx([2.0 * INNER, 2.0 * OUTER])
    text = next(one.dxf.text for one in space.query("TEXT"))
    assert text.startswith("z 300: lower left 511999")
    code, _, said = run(*words, "-o", "flat.svg")
    assert code == 0
    assert "1 mm on paper is 0.025" in said
    page = ET.parse(tmp_path / "flat.svg").getroot()  # noqa: S314 - our own
    groups = page.findall("{*}g")
    assert [one.get("id") for one in groups] == ["section-z=300", "section-y=5403000"]
    (path,) = (one for one in groups[0].findall("{*}path") if one.get("class") == "closed")
    rings_drawn = [one for one in str(path.get("d")).split("Z") if one]
    widths = [np.ptp([float(at.split()[0]) for at in one[1:].split("L")]) for one in rings_drawn]
    assert sorted(widths) == pytest.approx([2.0 * INNER / 0.025, 2.0 * OUTER / 0.025], abs=2e-3)


def test_heights_in_feet_count_as_long_as_they_are(tmp_path: Path) -> None:
    pipe = make_pipe()
    feet = Mesh(pipe.vertices / (1.0, 1.0, 0.3048), pipe.faces, PLACE / (1.0, 1.0, 0.3048))
    crs = Crs("EPSG:25832", "m", "ft")
    planes = ["x=512000", f"512000,5403000,{300 / 0.3048},1,0,0.3048"]
    upright, oblique = make_sections(feet, crs, planes, None, None, None, "pipe")
    assert upright.area == pytest.approx(2.0 * 4.0 * (OUTER - INNER), rel=1e-6)
    heights = np.concatenate([one.points[:, 2] for one in upright.outlines])
    assert np.ptp(heights) == pytest.approx(4.0 / 0.3048)
    assert oblique.area == pytest.approx(2.0**0.5 * np.pi * (OUTER**2 - INNER**2), rel=1e-3)


def test_points_are_meshed_first(run: Run, tmp_path: Path) -> None:
    normals: FloatArray = np.random.default_rng(0).normal(size=(3000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    write_points(tmp_path / "ball.ply", PointCloud(2.0 * normals, normals))
    code, table, said = run("section", "ball.ply", "--plane", "z=1", "-o", "ball.svg", "--json")
    assert code == 0
    assert "points, which are meshed first" in said
    (section,) = json.loads(table)["sections"]
    assert (section["outlines"], section["closed"]) == (1, 1)
    assert section["area"] == pytest.approx(3.0 * np.pi, rel=0.01)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["ball.ply", "ball.svg"]


def test_what_cannot_be_cut_is_refused_in_one_line(
    run: Run, road: Path, axis: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty.geojson").write_text('{"type": "Point", "coordinates": [1, 2]}')
    far = "LINESTRING (0 0, 1 1)"
    for code, words, problem in (
        (2, (), "nothing says where to cut"),
        (2, ("--plane", "z=1", "--along", str(axis)), "exclude each other"),
        (2, ("--plane", "q=1"), "it is no plane"),
        (2, ("--plane", "xy=1"), "it is no plane"),
        (2, ("--plane", "z=nan"), "it is no plane"),
        (2, ("--plane", "0,0,0,0,0,0"), "it is no plane"),
        (2, ("--plane", "z"), "nothing says where; write z=10"),
        (2, ("--plane", "z=1", "--step", "1"), "nothing to step along"),
        (2, ("--plane", "z", "--step", "1e-6"), "more than 10,000 sections"),
        (2, ("--along", str(axis), "--step", "1e-6"), "more than 10,000 sections"),
        (2, ("--along", str(axis), "--width", "3"), "--width is for sections across"),
        (3, ("--along", "no.geojson"), "no.geojson"),
        (3, ("--along", "empty.geojson"), "no line in it"),
        (2, ("--along", "LINESTRING (0 0, 0 0)"), "not valid"),
        (
            3,
            ("--along", far, "--step", "1"),
            "no section along the line meets its surface; it lies",
        ),
        (3, ("--plane", "z=1"), "no plane meets its surface; it lies from 512000 5403000 300"),
    ):
        assert_refused(run("section", str(road), "-o", "cut.svg", *words), code, problem)
    line = ("section", str(road), "--plane", "z=302")
    assert_refused(run(*line, "-o", "cut.png"), 2, "is no drawing")
    assert_refused(run(*line, "-o", "cut.geojson", "--flat"), 2, "not flat")
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    assert_refused(run(*line, "-o", "cut.dxf"), 2, "DXF needs the package ezdxf")
    assert not list(tmp_path.glob("cut*"))


def assert_refused(result: tuple[int, str, str], code: int, problem: str) -> None:
    assert result[0] == code
    last = result[2].strip().splitlines()[-1]
    assert last.startswith("hpcapp: ")
    assert problem in last
