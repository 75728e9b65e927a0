"""Names and units of coordinate reference systems."""

from __future__ import annotations

import struct

import pytest

from hpcapp.io.crs import Crs, is_geocentric, parse_epsg, parse_geokeys, parse_wkt

GEOGRAPHIC = 'GEOGCS["NAD83",DATUM["D",SPHEROID["S",6378137,298.25]],UNIT["degree",0.0174532925]]'
UTM_2 = """PROJCRS["WGS 84 / UTM zone 23S",
    BASEGEOGCRS["WGS 84", PRIMEM["Greenwich",0, ANGLEUNIT["degree",0.0174532925199433]]],
    CONVERSION["UTM", PARAMETER["False easting",500000, LENGTHUNIT["metre",1]]],
    CS[Cartesian,2],
        AXIS["(E)",east, ORDER[1], LENGTHUNIT["{name}",{factor}]],
    ID["EPSG",32723]]"""


def make_keys(*entries: tuple[int, int, int, int]) -> bytes:
    flat = [number for entry in ((1, 1, 0, len(entries)), *entries) for number in entry]
    return struct.pack(f"<{len(flat)}H", *flat)


@pytest.mark.parametrize(
    ("wkt", "unit"),
    [
        (f'PROJCS["a",{GEOGRAPHIC},UNIT["metre",1]]', "m"),
        (f'PROJCS["a",{GEOGRAPHIC},UNIT["foot",0.3048]]', "ft"),
        (f'PROJCS["a",{GEOGRAPHIC},UNIT["US survey foot",0.304800609601219]]', "US ft"),
        (f'PROJCS["a",{GEOGRAPHIC},UNIT["US survey foot",1.0]]', None),
        (f'PROJCS["a",{GEOGRAPHIC},UNIT["rod",5.0292]]', None),
        (f'PROJCS["a",{GEOGRAPHIC}]', None),
        (GEOGRAPHIC, "degree"),
        (f'COMPD_CS["a + b",{GEOGRAPHIC},VERT_CS["b",UNIT["metre",1]]]', "degree"),
        (f'COMPD_CS["a",PROJCS["a",{GEOGRAPHIC},UNIT["m",1]],VERT_CS["b",UNIT["f",0.3048]]]', "m"),
        # A vertical system within the horizontal one, as some programs write it.
        ('PROJCS["a",UNIT["f",0.3048],VERTCS["b",UNIT["m",1]]]', "ft"),
        ('GEOCCS["a",UNIT["metre",1]]', "m"),
        (UTM_2.format(name="metre", factor=1), "m"),
        (UTM_2.format(name="foot", factor=0.3048), "ft"),
        ('GEODCRS["WGS 84",CS[ellipsoidal,2],ANGLEUNIT["degree",0.0174532925]]', "degree"),
        ('GEODCRS["WGS 84",CS[Cartesian,3],LENGTHUNIT["metre",1]]', "m"),
        ('LOCAL_CS["a ""site"" [1]",UNIT["millimetre",0.001]]', "mm"),
    ],
)
def test_unit_of_wkt(wkt: str, unit: str | None) -> None:
    crs = parse_wkt(wkt)
    assert (crs.text, crs.unit) == (wkt, unit)


FEET = f'PROJCS["a",{GEOGRAPHIC},UNIT["US survey foot",0.304800609601219]]'


@pytest.mark.parametrize(
    ("wkt", "height_unit", "scale"),
    [
        (FEET, None, 1.0),
        (f'COMPD_CS["a + b",{FEET},VERT_CS["b",UNIT["metre",1]]]', "m", 3937 / 1200),
        (f'COMPD_CS["a + b",{FEET},VERT_CS["b",UNIT["foot",0.3048]]]', "ft", 1.0),
        ('PROJCS["a",UNIT["f",0.3048],VERTCS["b",UNIT["m",1]]]', "m", 1.0 / 0.3048),
        (
            f'COMPOUNDCRS["a",{UTM_2.format(name="metre", factor=1)},VERTCRS["b",CS[vertical,1],'
            'AXIS["up",up,LENGTHUNIT["foot",0.3048]]]]',
            "ft",
            0.3048,
        ),
        (f'COMPD_CS["a + b",{GEOGRAPHIC},VERT_CS["b",UNIT["metre",1]]]', None, 1.0),
    ],
)
def test_heights_may_have_a_unit_of_their_own(
    wkt: str, height_unit: str | None, scale: float
) -> None:
    crs = parse_wkt(wkt)
    assert crs.height_unit == height_unit
    assert crs.height_scale == pytest.approx(scale)


def test_keys_tell_the_unit_of_heights() -> None:
    keys = make_keys((1024, 0, 1, 1), (3072, 0, 1, 2903), (3076, 0, 1, 9003), (4099, 0, 1, 9001))
    crs = parse_geokeys(keys, b"")
    assert crs == Crs("EPSG:2903", "US ft", "m")
    assert crs.height_scale == pytest.approx(3937 / 1200)


@pytest.mark.parametrize(
    "wkt", ["", "nothing", "]]]", '"', "PROJCS[", 'PROJCS["a",UNIT[', "A" * 99]
)
def test_damaged_wkt_has_no_unit(wkt: str) -> None:
    assert parse_wkt(wkt) == Crs(wkt, None)


def test_deeply_nested_wkt_is_read() -> None:
    assert parse_wkt("A[" * 100_000).unit is None


@pytest.mark.parametrize(
    ("entries", "crs"),
    [
        ([(1024, 0, 1, 1), (3072, 0, 1, 26915), (3076, 0, 1, 9001)], Crs("EPSG:26915", "m")),
        ([(1024, 0, 1, 1), (3072, 0, 1, 2903), (3076, 0, 1, 9003)], Crs("EPSG:2903", "US ft")),
        ([(1024, 0, 1, 1), (3072, 0, 1, 2903)], Crs("EPSG:2903", None)),
        ([(1024, 0, 1, 1), (3072, 0, 1, 32632)], Crs("EPSG:32632", "m")),
        ([(1024, 0, 1, 2), (2048, 0, 1, 4326), (2054, 0, 1, 9102)], Crs("EPSG:4326", "degree")),
        ([(1024, 0, 1, 3), (2048, 0, 1, 4326)], Crs(None, "m")),  # earth-centred
        ([(1024, 0, 1, 3), (2048, 0, 1, 4978)], Crs("EPSG:4978", "m")),
        # The code of the system in the place of the unit: the unit stands elsewhere.
        ([(1024, 0, 1, 1), (3076, 0, 1, 32632), (2052, 0, 1, 9001)], Crs(None, "m")),
        ([(1024, 0, 1, 1), (1026, 34737, 5, 1), (3072, 0, 1, 32767)], Crs("Site", None)),
        ([], None),
    ],
)
def test_geotiff_keys(entries: list[tuple[int, int, int, int]], crs: Crs | None) -> None:
    assert parse_geokeys(make_keys(*entries), b"|Site|") == crs


@pytest.mark.parametrize(
    ("text", "is_said"),
    [
        ("EPSG:4978", True),
        ("EPSG:7789", True),
        ("EPSG:4979", False),
        ("EPSG:32632", False),
        ('GEOCCS["WGS 84",UNIT["metre",1]]', True),
        ('GEODCRS["ITRF",CS[Cartesian,3],AXIS["x",geocentricX],LENGTHUNIT["metre",1]]', True),
        ('GEODCRS["a",CS[ellipsoidal,3],AXIS["b",north,ANGLEUNIT["degree",0.017]]]', False),
        (UTM_2.format(name="metre", factor=1), False),
        (GEOGRAPHIC, False),
        ("a name", False),
        (None, False),
    ],
)
def test_what_is_from_the_centre_of_the_earth(text: str | None, is_said: bool) -> None:
    assert is_geocentric(text) == is_said


@pytest.mark.parametrize("size", range(12))
def test_cut_geotiff_keys(size: int) -> None:
    assert parse_geokeys(make_keys((1024, 0, 1, 1))[:size], b"") is None


@pytest.mark.parametrize("text", ["EPSG:0", "EPSG:99999", "EPSG:", "32632", "EPSG:32632 and more"])
def test_what_is_no_code(text: str) -> None:
    assert parse_epsg(text) is None
