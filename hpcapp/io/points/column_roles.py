"""What a column is, by its name and by its values.

Programs spell the same columns in many ways, and many files have no names at all. Readers ask
for the role of a name; who has unnamed columns, or doubts a name, asks what the values can be.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal

import numpy as np

from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.geometry.validity import are_finite
from hpcapp.io.columns import Numbers

AXES = ("x", "y", "z")
NORMALS = ("nx", "ny", "nz")
COLOURS = ("red", "green", "blue")

ColourScale = Literal["8 bit", "16 bit", "float"]
"""Whole numbers to 255, whole numbers to 65535, or numbers from 0 to 1."""

NormalKind = Literal["unit", "encoded", "any length", "zero", "one octant", "none"]
"""Unit vectors; (n + 1) / 2; vectors of other lengths on all sides; zeros; vectors of which no
component is negative, as no closed cloud has them; or none of these: no normals."""

MOST_COLUMNS = 4096
"""That a point may have: features and spectra have some hundreds."""

_DEPTHS = ("depth", "depths", "tiefe")
_SPELLINGS = {
    **dict.fromkeys(("x", "px", "pointx", "coordx", "xcoordinate", "points0"), "x"),
    **dict.fromkeys(("y", "py", "pointy", "coordy", "ycoordinate", "points1"), "y"),
    **dict.fromkeys(("z", "pz", "pointz", "coordz", "zcoordinate", "points2"), "z"),
    **dict.fromkeys(("easting", "east", "rechtswert", "ostwert"), "x"),
    **dict.fromkeys(("northing", "north", "hochwert", "nordwert"), "y"),
    **dict.fromkeys(("lon", "long", "lng", "longitude"), "x"),
    **dict.fromkeys(("lat", "latitude"), "y"),
    **dict.fromkeys(("elevation", "elev", "height", "alt", "altitude"), "z"),
    **dict.fromkeys(("hoehe", "hohe", "hhe"), "z"),  # the last is left of an umlaut
    **dict.fromkeys(_DEPTHS, "z"),
    **{f"cartesian{axis}": axis for axis in "xyz"},
    **{
        f"{stem}{axis}": f"n{axis}"
        for stem in ("n", "normal", "normals", "nor", "nornormal")  # the last in E57
        for axis in "xyz"
    },
    **{f"{stem}{name}": name for stem in ("", "diffuse", "color", "colour") for name in COLOURS},
    **dict(zip(("normals0", "normals1", "normals2"), NORMALS, strict=True)),
    **dict(zip(("rgb0", "rgb1", "rgb2"), COLOURS, strict=True)),
    **dict(zip("rgb", COLOURS, strict=True)),
    **dict(zip(("rf", "gf", "bf"), COLOURS, strict=True)),
    **dict.fromkeys(("a", "alpha", "diffusealpha"), "alpha"),
    **dict.fromkeys(("intensity", "i", "scalarintensity"), "intensity"),
    "rowindex": "row",
    "columnindex": "column",
    **dict.fromkeys(("class", "classification", "scalarclassification"), "classification"),
}
_TIMES = frozenset(("gpstime", "time", "timestamp", "t", "seconds"))
_LETTERS = {"n": "northing", "e": "easting", "h": "height", "el": "elevation"}
_LETTERS_IN_ONE = re.compile(r"p?(ne|en)[zh]d?")  # PNEZD, as surveyors say what a list holds
_BRACKET = re.compile(r"[\[(]")
_NAMED = 5  # columns in a message
_UNIT = 0.05  # how far from 1 the length of a unit vector may be: two decimals of each component
_MOST = 0.9  # share of the rows that decide: a file may have some bad ones


def find_role(name: str) -> str:
    """Return the name of a column as we call it.

    It is ``x``, ``y``, ``z``, ``nx``, ``ny``, ``nz``, ``red``, ``green``, ``blue``, ``alpha``,
    ``intensity``, ``classification``, ``row``, ``column``, or as the file has it, without quotes
    and blanks around it.

    Examples
    --------
    >>> [find_role(name) for name in ("//X", '"Normal_Y"', "diffuse_red", "Z [m]", "OffsetTime")]
    ['x', 'ny', 'red', 'z', 'OffsetTime']
    """
    return _SPELLINGS.get(_strip(name), name.strip().strip("\"'").strip())


def counts_down(names: Sequence[str]) -> bool:
    """Tell whether the heights of a file are depths, by the names of its columns.

    Examples
    --------
    >>> counts_down(["X", "Y", "Depth (m)"]), counts_down(["x", "y", "z", "depth"])
    (True, False)
    """
    heights = [_strip(name) for name in names if find_role(name) == "z"]
    return bool(heights) and all(name in _DEPTHS for name in heights)


def is_time(name: str) -> bool:
    """Tell whether a column is of times.

    Examples
    --------
    >>> [is_time(name) for name in ("gps_time", "GpsTime [s]", "//Timestamp", "OffsetTime")]
    [True, True, True, False]
    """
    return _strip(name) in _TIMES


def spell_letters(names: Sequence[str]) -> tuple[str, ...]:
    """Return names of columns, N, E, H and EL in full where N and E stand together without X and Y.

    Examples
    --------
    >>> spell_letters(["P", "N (ft)", "E", "Z", "D"]), spell_letters(["X", "Y", "Z", "N"])
    (('P', 'northing (ft)', 'easting', 'Z', 'D'), ('X', 'Y', 'Z', 'N'))
    """
    letters = [_strip(name) for name in names]
    if len(names) == 1 and _LETTERS_IN_ONE.fullmatch(letters[0]):
        return spell_letters([*letters[0].upper()])
    if not {"n", "e"} <= set(letters) or {"x", "y"} & set(letters):
        return tuple(names)
    pairs = zip(names, letters, strict=True)
    return tuple(
        re.sub(re.escape(letter), _LETTERS[letter], name, count=1, flags=re.IGNORECASE)
        if letter in _LETTERS
        else name
        for name, letter in pairs
    )


def _strip(name: str) -> str:
    """Return the letters and digits of a name, in lower case, without a unit in brackets."""
    bare = name.strip().strip("\"'").strip().lower()
    if bare.endswith(("]", ")")):
        bare = bare[:1] + _BRACKET.split(bare[1:], 1)[0]
    return re.sub(r"[^a-z0-9]", "", bare)


def name_columns(cloud: PointCloud) -> tuple[str, ...]:
    """Return the names of all columns of a cloud, as we call them."""
    normals = NORMALS if cloud.normals is not None else ()
    colours = COLOURS if cloud.colours is not None else ()
    return (*AXES, *normals, *colours, *cloud.attributes)


def name_some(names: Sequence[str]) -> str:
    """Name columns for a message: of many their number, and the first.

    Examples
    --------
    >>> name_some(["a", "b"]), name_some(list("abcdefgh"))
    ('a, b', '8 columns, a, b, c, d, e and so on')
    """
    if len(names) > _NAMED:
        return f"{len(names)} columns, {', '.join(names[:_NAMED])} and so on"
    return ", ".join(names)


def judge_colours(values: Numbers) -> ColourScale | None:
    """Tell which colours the columns of all rows, or of a sample, can hold.

    None where a value is negative, NaN, or too large for any of them. Zeros are 8 bit; zeros and
    ones alone are 8 bit where they are whole numbers by their type.
    """
    if not len(values) or not np.isfinite(values).all() or values.min() < 0:
        return None
    most = values.max()
    if values.dtype.kind == "f" and 0 < most <= 1:
        return "float"
    if most > 65535 or not (values == np.rint(values)).all():
        return None
    return "8 bit" if most <= 255 else "16 bit"


def judge_normals(values: FloatArray) -> NormalKind:
    """Tell which normals three columns of all rows, or of a sample, can hold.

    Rows with NaN or infinity do not count.
    """
    finite = values[are_finite(values)]
    lengths = _lengths(finite)
    directed = lengths > 0
    if not directed.any():
        return "zero"
    is_unit = (np.abs(lengths[directed] - 1) < _UNIT).mean() > _MOST
    if finite.min() >= 0:
        if finite.max() <= 1 and (np.abs(_lengths(2 * finite - 1) - 1) < _UNIT).mean() > _MOST:
            return "encoded"
        return "one octant" if is_unit else "none"
    if is_unit:
        return "unit"
    # Without unit length only vectors on all sides are taken for normals.
    return "any length" if (finite.min(axis=0) < 0).all() else "none"


def _lengths(vectors: FloatArray) -> FloatArray:
    """Return the lengths of vectors, infinite ones among them."""
    x, y, z = vectors.T
    with np.errstate(over="ignore", under="ignore"):
        lengths: FloatArray = np.sqrt(x * x + y * y + z * z)
    return lengths


def tell_use(name: str, cloud: PointCloud) -> str:
    """Say as what a column of a file was taken, given what was read from it.

    ``position``, ``normal``, ``colour``, ``attribute`` or ``left out``.
    """
    role = find_role(name)
    if role in AXES:
        return "position"
    if role in NORMALS and cloud.normals is not None:
        return "normal"
    if role in COLOURS and cloud.colours is not None:
        return "colour"
    return "attribute" if role in cloud.attributes or name in cloud.attributes else "left out"
