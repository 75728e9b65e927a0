"""Polygons from files, and what is said of files that hold none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import shapefile
import shapely

from hpcapp.io.outlines import read_outline
from hpccomponent.errors import InputError, UsageError

SQUARE = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0], [0.0, 0.0]]
HOLE = [[1.0, 1.0], [1.0, 2.0], [2.0, 2.0], [1.0, 1.0]]
FAR = [[512025.25, 5403025.125], [512030.0, 5403025.0], [512030.0, 5403031.0], [512025.25, 5403025.125]]  # fmt: skip  # noqa: E501
POLYGON = {"type": "Polygon", "coordinates": [SQUARE, HOLE]}
MULTI = {"type": "MultiPolygon", "coordinates": [[SQUARE, HOLE], [FAR]]}
LINE = {"type": "LineString", "coordinates": SQUARE}


def feature(geometry: object) -> dict[str, object]:
    return {"type": "Feature", "properties": {"name": "yard"}, "geometry": geometry}


@pytest.mark.parametrize(
    "found",
    [
        MULTI,
        feature(MULTI),
        {"type": "FeatureCollection", "features": [feature(MULTI), feature(None)]},
        {"type": "FeatureCollection", "features": [feature(POLYGON), feature(LINE), feature(
            {"type": "Polygon", "coordinates": [[[*place, 7.0] for place in FAR]]})]},
        {"type": "GeometryCollection", "geometries": [MULTI, LINE]},
    ],
)  # fmt: skip
def test_all_polygons_of_geojson_are_one(found: object, tmp_path: Path) -> None:
    path = tmp_path / "yard.geojson"
    path.write_text(json.dumps(found), "utf-8-sig")
    outline = shapely.from_wkt(read_outline(str(path)))
    assert outline.equals(shapely.geometry.shape(MULTI))
    assert outline.bounds == (0.0, 0.0, 512030.0, 5403031.0)  # no digit is lost
    assert not outline.has_z


def test_wkt_is_read_from_a_file_and_as_it_is(tmp_path: Path) -> None:
    text = shapely.geometry.shape(MULTI).wkt
    one, two = shapely.get_parts(shapely.from_wkt(text))
    for written in (
        text,
        f"SRID=25832;{text}",
        f"{one.wkt}\n{two.wkt}\n",
        text.replace(",", ",\n"),
    ):
        path = tmp_path / "yard.wkt"
        path.write_text(written)
        assert shapely.from_wkt(read_outline(str(path))).equals(shapely.from_wkt(text))
    assert shapely.from_wkt(read_outline(text)).equals(shapely.from_wkt(text))


def test_a_shapefile_is_read(tmp_path: Path) -> None:
    with shapefile.Writer(tmp_path / "yard", shapefile.POLYGON) as writer:
        writer.field("name", "C")
        writer.poly([SQUARE[::-1], HOLE[::-1]])
        writer.record("yard")
        writer.poly([FAR[::-1]])
        writer.record("far")
    for other in (".dbf", ".shx"):
        (tmp_path / "yard").with_suffix(other).unlink()  # the shapes are enough
    outline = shapely.from_wkt(read_outline(str(tmp_path / "yard.shp")))
    assert outline.equals(shapely.geometry.shape(MULTI))


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.geojson", b"{", "no GeoJSON"),
        ("a.geojson", b"[1, 2]", "no GeoJSON"),
        ("a.geojson", b'{"type": "Point", "coordinates": [1, 2]}', "no polygon"),
        ("a.geojson", b'{"type": "FeatureCollection", "features": [1, "b"]}', "no polygon"),
        ("a.geojson", b'{"type": "FeatureCollection", "features": 7}', "no polygon"),
        ("a.geojson", b'{"type": "Polygon", "coordinates": [[1, 2], [3]]}', "cannot be read"),
        ("a.geojson", b'{"type": "Polygon", "coordinates": [[[1, 2], [1, 2]]]}', "cannot be read"),
        ("a.geojson", b'{"type": "Polygon", "coordinates": [[["a", 2], [1, 2], [3, 4], [5, 6]]]}',
         "cannot be read"),
        ("a.geojson", b'{"type": "Polygon", "coordinates": [[[0, 0], [4, 4], [4, 0], [0, 4]]]}',
         r"not valid: Self-intersection\[2 2\]"),
        ("a.geojson", b'{"type": "Polygon", "coordinates": [[[0, 0], [1e99, 4], [4, 0]]]}',
         "no number up to"),
        ("a.geojson", b'{"type": "Polygon", "coordinates": []}', "no polygon"),
        ("a.wkt", b"POLYGON ((1 2, 3", "no WKT"),
        ("a.wkt", b"", "no polygon"),
        ("a.wkt", b"LINESTRING (0 0, 1 1)", "no polygon"),
        ("a.wkt", b"POLYGON ((0 0, 4 0, 4 4, 0 0))\0, 9 9", "zero byte"),
        ("a.shp", b"nothing of the kind", "no shapefile"),
        ("a.shp", b"", "no shapefile"),
        ("a.dxf", b"0\nSECTION\n", "neither WKT nor a file of a known kind"),
    ],
)  # fmt: skip
def test_what_is_no_polygon_is_one_line(
    name: str, content: bytes, said: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=said) as found:
        read_outline(str(path))
    assert "\n" not in found.value.problem
    assert str(path) in found.value.problem


CURVED = "CURVEPOLYGON (CIRCULARSTRING (0 0, 4 0, 4 4, 0 4, 0 0))"


@pytest.mark.parametrize("depth", [40, 900, 50_000, 500_000])
@pytest.mark.parametrize("shape", [
    "POLYGON {}0 0, 1 0, 1 1, 0 0{}",
    "GEOMETRYCOLLECTION {}POLYGON ((0 0, 1 0, 1 1, 0 0)){}",
])  # fmt: skip
def test_wkt_that_is_nested_deeply_is_refused(shape: str, depth: int, tmp_path: Path) -> None:
    """GEOS would end the process."""
    path, text = tmp_path / "a.wkt", shape.format(depth * "(", depth * ")")
    path.write_text(text)
    with pytest.raises(InputError, match=r"a\.wkt: no WKT: it is nested more than 32 deep"):
        read_outline(str(path))
    with pytest.raises(UsageError, match=r"^polygon: no WKT: it is nested more than 32 deep"):
        read_outline(text)


@pytest.mark.parametrize("depth", [40, 300, 900, 200_000])
@pytest.mark.parametrize("shape", [
    '{{"type": "Polygon", "coordinates": {}0{}}}',
    '{{"features": {}{}}}',
    '{{"type": "MultiPolygon", "coordinates": [[[[0, 0], {}[1, 1]{}]]]}}',
])  # fmt: skip
def test_geojson_that_is_nested_deeply_is_one_line(shape: str, depth: int, tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    path.write_text(shape.format(depth * "[", depth * "]"))
    with pytest.raises(InputError, match=r"a\.geojson: ") as found:
        read_outline(str(path))
    assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    "number", ["1" + 400 * "0", "1" + 5000 * "0", "1e400", '"1"', "null", "{}"]
)
def test_what_is_no_coordinate_is_one_line(number: str, tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    places = f"[[[0, 0], [{number}, 0], [4, 4], [0, 0]]]"
    path.write_text(f'{{"type": "Polygon", "coordinates": {places}}}')
    with pytest.raises(InputError, match=r"a\.geojson: ") as found:
        read_outline(str(path))
    assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    "text",
    [CURVED, f"MULTISURFACE ({CURVED})", CURVED.lower(), f"GEOMETRYCOLLECTION ({CURVED})",
     "CURVEPOLYGON Z (COMPOUNDCURVE Z (CIRCULARSTRING Z (0 0 1, 2 1 1, 4 0 1), (4 0 1, 0 0 1)))"],
)  # fmt: skip
def test_curves_say_how_they_become_straight(text: str, tmp_path: Path) -> None:
    path = tmp_path / "a.wkt"
    path.write_text(text)
    with pytest.raises(
        InputError, match=r"a\.wkt: it has curves .*'Segmentize by maximum distance'"
    ):
        read_outline(str(path))
    with pytest.raises(UsageError, match=r"^polygon: it has curves"):
        read_outline(text)


def test_a_file_may_be_called_as_a_shape(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("polygon (1).wkt").write_text("POLYGON ((0 0, 4 0, 4 4, 0 0))")
    assert shapely.from_wkt(read_outline("polygon (1).wkt")).area == 8.0


@pytest.mark.parametrize(
    ("at", "number", "said"),
    [
        (32, 77, "shapes of type 77"),
        (32, 1, "shapes of type 1"),
        (24, 7, "and has"),
        (100 + 4, 1 << 24, "cut"),
        (108, 77, "another length or type"),
        (108, 3, "another length or type"),
        (108, 0, "another length or type"),
        (108 + 36, 1, "another length or type"),
        (108 + 40, 5, "another length or type"),
        (108 + 40, -1, "another length or type"),
        (108 + 44, 1, "do not follow each other"),
        (108 + 48, -1, "do not follow each other"),
        (108 + 48, 0, "do not follow each other"),
        (108 + 48, 99, "do not follow each other"),
    ],
)
def test_a_damaged_shapefile_is_not_read_in_part(
    at: int, number: int, said: str, tmp_path: Path
) -> None:
    with shapefile.Writer(tmp_path / "yard", shapefile.POLYGON) as writer:
        writer.field("name", "C")
        writer.poly([SQUARE[::-1], HOLE[::-1]])
        writer.record("yard")
    path = tmp_path / "yard.shp"
    content = bytearray(path.read_bytes())
    content[at : at + 4] = number.to_bytes(4, "little", signed=True)
    path.write_bytes(content)
    with pytest.raises(InputError, match=f"no shapefile: .*{said}"):
        read_outline(str(path))


def test_a_file_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        read_outline(str(tmp_path / "none.geojson"))
