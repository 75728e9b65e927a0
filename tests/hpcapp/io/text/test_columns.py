from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.points import FloatArray
from hpcapp.io.points.point_source import Findings
from hpcapp.io.text.columns import TableColumns, assign_by_name, assign_by_value
from hpcapp.io.text.tables import RowNotes
from hpccomponent.errors import InputError

RANDOM = np.random.default_rng(4)
POINTS = RANDOM.uniform(-5, 5, (300, 3))
VECTORS = RANDOM.normal(size=(300, 3))
UNIT = VECTORS / np.linalg.norm(VECTORS, axis=1, keepdims=True)
UP = np.tile([0.0, 0.0, 1.0], (300, 1))
BYTES = RANDOM.integers(0, 256, (300, 3)).astype(np.float64)
BYTE = RANDOM.integers(0, 256, (300, 1)).astype(np.float64)
OPAQUE = np.full((300, 1), 255.0)
SIGNED = RANDOM.integers(-2000, 2000, (300, 1)).astype(np.float64)
SHARE = RANDOM.uniform(0, 1, (300, 1))
ZEROS = np.zeros((300, 3))
COLOURS = "red green blue"
NORMALS = "nx ny nz"


def _assign(*groups: FloatArray, name: str = "a.xyz") -> tuple[str, TableColumns, str]:
    sample = np.hstack([POINTS, *groups])
    findings = Findings()
    columns = assign_by_value(Path(name), sample, tuple(range(sample.shape[1])), findings)
    assert columns.roles[:3] == ("x", "y", "z")
    return " ".join(columns.roles[3:]), columns, "; ".join(findings.warnings)


@pytest.mark.parametrize(
    ("groups", "roles"),
    [
        ([], ""),
        ([SHARE], "intensity"),
        ([SIGNED], "intensity"),
        ([UNIT], NORMALS),
        ([UP], NORMALS),
        ([ZEROS], NORMALS),
        ([(UNIT + 1) / 2], NORMALS),
        ([BYTES], COLOURS),
        ([BYTE, BYTES], f"intensity {COLOURS}"),
        ([SIGNED, BYTES], f"intensity {COLOURS}"),
        ([0 * OPAQUE, BYTES[:, :2], OPAQUE], f"intensity {COLOURS}"),
        ([BYTES, OPAQUE], f"{COLOURS} alpha"),
        ([BYTES, SIGNED], f"{COLOURS} intensity"),
        ([UNIT, SHARE], f"{NORMALS} intensity"),
        ([UP, BYTE], f"{NORMALS} intensity"),
        ([BYTE, UNIT], f"intensity {NORMALS}"),
        ([UNIT, BYTES], f"{NORMALS} {COLOURS}"),
        ([BYTES, UNIT], f"{COLOURS} {NORMALS}"),
        ([ZEROS, BYTES], f"{NORMALS} {COLOURS}"),
        ([BYTES, ZEROS], f"{COLOURS} {NORMALS}"),
        ([UNIT, ZEROS], f"{NORMALS} {COLOURS}"),
        ([UNIT, BYTES, OPAQUE], f"{NORMALS} {COLOURS} alpha"),
        ([BYTE, UNIT, BYTES], f"intensity {NORMALS} {COLOURS}"),
        ([BYTES, UNIT, SHARE], f"{COLOURS} {NORMALS} intensity"),
    ],
)
def test_values_tell_what_they_are(groups: list[FloatArray], roles: str) -> None:
    assert _assign(*groups)[::2] == (roles, "")


@pytest.mark.parametrize(
    ("groups", "roles", "warning"),
    [
        (
            [BYTES / 255],
            COLOURS,
            "columns 4 to 6 have no names and are taken for colours of 0 to 1",
        ),
        (
            [UNIT, BYTES / 255, SHARE],
            f"{NORMALS} {COLOURS} alpha",
            "columns 7 to 9 .* colours of 0",
        ),
        ([BYTES * 257], COLOURS, "colours of 16 bit"),
        ([VECTORS * 3], NORMALS, "normals, though their lengths differ from 1"),
        ([SHARE, SIGNED], "intensity column_5", "without a name, and kept as attributes: column_5"),
        ([np.abs(VECTORS) * 3], "intensity column_5 column_6", "column_5, column_6"),
    ],
)
def test_guesses_are_told(groups: list[FloatArray], roles: str, warning: str) -> None:
    found, _, warnings = _assign(*groups)
    assert found == roles
    assert re.search(warning, warnings)


@pytest.mark.parametrize(
    ("name", "groups", "roles"),
    [
        ("a.xyzn", [VECTORS], NORMALS),
        ("a.XYZN", [UNIT, BYTES], f"{NORMALS} {COLOURS}"),
        ("a.xyzrgb", [BYTES / 255], COLOURS),
        ("a.xyzrgb", [BYTES / 255, UNIT], f"{COLOURS} {NORMALS}"),
        ("a.xyzi", [BYTE, BYTES], f"intensity {COLOURS}"),
        ("a.pts", [BYTE, ZEROS], f"intensity {COLOURS}"),
        ("a.pts", [BYTE, BYTES], f"intensity {COLOURS}"),
    ],
)
def test_suffixes_promise_columns(name: str, groups: list[FloatArray], roles: str) -> None:
    assert _assign(*groups, name=name)[::2] == (roles, "")


def test_a_promise_must_be_kept() -> None:
    with pytest.raises(InputError, match=r"4 columns, a \.xyzn file has x y z nx ny nz"):
        _assign(SHARE, name="a.xyzn")


def test_a_sample_without_rows_tells_nothing() -> None:
    columns = assign_by_value(Path("a.xyz"), np.empty((0, 6)), tuple(range(6)), Findings())
    assert not columns.has_normals
    assert not columns.has_colours


@pytest.mark.parametrize(
    ("names", "roles"),
    [
        ("nx ny nz x y z", "nx ny nz x y z"),
        ("northing Easting height", "y x z"),
        ("lon lat height x y z", "lon lat height x y z"),
        ("lon lat height", "x y z"),
        ("x y z R G B r", "x y z red green blue r"),
        ("x y z i intensity i", "x y z i intensity i_2"),
        ("X Y Z Time time", "x y z Time time"),
    ],
)
def test_columns_go_by_their_names(names: str, roles: str) -> None:
    words = names.split()
    assert " ".join(assign_by_name(words, np.zeros((1, len(words)))).roles) == roles


@pytest.mark.parametrize(
    ("values", "dtype"), [(BYTES, np.uint8), (BYTES * 257, np.uint16), (BYTES / 255, np.float64)]
)
def test_clouds_are_made_of_rows(values: FloatArray, dtype: type) -> None:
    table = np.hstack([values, POINTS, UNIT, SHARE])
    columns = assign_by_name(f"{COLOURS} x y z {NORMALS} t".split(), table)
    cloud = columns.make_cloud(table, 0, RowNotes(Path("a")))
    assert (cloud.positions == POINTS).all()
    np.testing.assert_array_equal(cloud.normals, UNIT)
    np.testing.assert_array_equal(cloud.colours, values)
    assert cloud.colours is not None
    assert cloud.colours.dtype == dtype
    assert list(cloud.attributes) == ["t"]
    assert (cloud.attributes["t"] == SHARE[:, 0]).all()


def test_incomplete_groups_are_attributes() -> None:
    table = np.arange(7.0).reshape(1, 7)
    cloud = assign_by_name(["x", "y", "z", "nx", "ny", "red", "blue"], table).make_cloud(
        table, 0, RowNotes(Path("a"))
    )
    assert cloud.normals is None
    assert cloud.colours is None
    assert {name: column[0] for name, column in cloud.attributes.items()} == {
        "nx": 3,
        "ny": 4,
        "red": 5,
        "blue": 6,
    }


def test_colours_that_the_sample_had_none_of() -> None:
    columns = TableColumns(("x", "y", "z", "red", "green", "blue"), "8 bit")
    notes, findings = RowNotes(Path("a.xyz")), Findings()
    table = np.array([[1, 2, 3, 4, 5, 6], [1, 2, 3, np.nan, 5, 6]])
    cloud = columns.make_cloud(table, 10, notes)
    np.testing.assert_array_equal(cloud.colours, [[4, 5, 6], [255, 255, 255]])
    notes.tell(findings)
    assert findings.warnings == ["point 11 has no colour: it is white"]
    for wrong in (256, -1, 0.5, np.inf):
        table[0, 4] = wrong
        with pytest.raises(InputError, match=r"a\.xyz: point 10 has the colour"):
            columns.make_cloud(table, 10, notes)
