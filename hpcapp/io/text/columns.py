"""What the columns of a text file are: by their names, by the file's suffix, or by their values.

Where nothing is named, x, y and z come first, behind the number of the point or the time (see
`leading`). What follows is told by its values: three columns of
unit vectors are normals, three of whole numbers (or of numbers from 0 to 1) are colours, and others
are single. Of four columns that could all be of a colour the first is the intensity, as PTS files
have it, unless the last is opaque throughout: then that is alpha.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.columns import Numbers
from hpcapp.io.points.column_roles import (
    AXES,
    COLOURS,
    NORMALS,
    ColourScale,
    find_role,
    judge_colours,
    judge_normals,
    name_some,
)
from hpcapp.io.points.point_source import Findings
from hpcapp.io.text.leading import are_on_map, find_named_order, find_order, is_time
from hpcapp.io.text.tables import RowNotes
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

DEGREES = ("lon", "long", "longitude", "lat", "latitude")
"""Names of coordinates that are angles, in lower case."""

_PROMISED = {".xyzn": NORMALS, ".pwn": NORMALS, ".xyzrgb": COLOURS, ".xyzi": ("intensity",)}
_OPAQUE = {"8 bit": 255, "16 bit": 65535, "float": 1}
_TIME = "time"
_WORDS = {"x": "easting", "y": "northing", "z": "height"}
_Kind = Literal["normals", "vectors", "zeros"] | ColourScale
_DOUBTS: dict[_Kind | None, str] = {
    "float": "colours of 0 to 1",
    "16 bit": "colours of 16 bit",
    "vectors": "normals, though their lengths differ from 1",
}


@dataclass(frozen=True, slots=True, eq=False)
class TableColumns:
    """Which columns of a table are what.

    Roles are named as by `find_role`, no two the same; colours have a scale by a sample, or None.
    """

    roles: tuple[str, ...]
    scale: ColourScale | None

    @property
    def has_normals(self) -> bool:
        """Whether there are all three components of normals."""
        return set(NORMALS) <= set(self.roles)

    @property
    def has_colours(self) -> bool:
        """Whether there are red, green and blue."""
        return set(COLOURS) <= set(self.roles)

    def make_cloud(self, table: FloatArray, first: int, notes: RowNotes) -> PointCloud:
        """Make points of rows (n, columns), the first of that number; note those without a colour.

        Normals stay as they are; colours are of 8 or 16 bit, or stay. Raise InputError where a
        colour is none of the scale of the others.
        """
        normals = self._take(table, NORMALS) if self.has_normals else None
        colours: Numbers | None = None
        if self.has_colours:
            colours = self._as_colours(self._take(table, COLOURS), first, notes)
        grouped = (*AXES, *(NORMALS if self.has_normals else ()))
        grouped += COLOURS if self.has_colours else ()
        attributes = {
            role: table[:, i].copy() for i, role in enumerate(self.roles) if role not in grouped
        }
        return PointCloud(self._take(table, AXES), normals, colours, attributes)

    def _take(self, table: FloatArray, roles: tuple[str, ...]) -> FloatArray:
        return table[:, [self.roles.index(role) for role in roles]]

    def _as_colours(self, values: FloatArray, first: int, notes: RowNotes) -> Numbers:
        if self.scale not in ("8 bit", "16 bit"):
            return values
        none, most = np.isnan(values).any(axis=1), _OPAQUE[self.scale]
        if none.any():
            values[none] = most
            notes.note("colour", f"point {first + int(np.argmax(none))} has no colour: it is white")
        wrong = ~((values >= 0) & (values <= most) & (values == np.rint(values))).all(axis=1)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(
                f"{notes.path}: point {first + row} has the colour {values[row].tolist()}",
                f"the others are whole numbers of 0 to {most}: correct or remove it",
            )
        return values.astype(np.uint8 if self.scale == "8 bit" else np.uint16)


def assign_by_name(names: list[str], sample: FloatArray) -> TableColumns:
    """Say what columns are by their names, x, y and z among them, as the file spells them.

    Of several columns with one role the best named has it, the others keep their names.
    """
    best: dict[str, int] = {}
    for i in sorted(range(len(names)), key=lambda i: _rank(names[i])):
        best.setdefault(find_role(names[i]), i)
    roles: dict[str, None] = {}
    numbers = dict.fromkeys(names, 1)
    for i, name in enumerate(names):
        role = find_role(name)
        if best[role] != i:
            role = name
        while role in roles or best.get(role, i) != i:
            numbers[name] += 1
            role = f"{name}_{numbers[name]}"
        roles[role] = None
    return _make_columns(list(roles), sample)


def _rank(name: str) -> int:
    """Return 0 for a plain name, 1 for another spelling, 2 for degrees: the last choice."""
    return 2 if name.lower() in DEGREES else int(find_role(name) != name.lower())


def assign_by_value(
    path: Path,
    sample: FloatArray,
    numbers: tuple[int, ...],
    findings: Findings,
    *,
    width: int = 0,
) -> TableColumns:
    """Say what columns without names are; the file's suffix may promise some.

    Samples (n, columns) come from all over the file; numbers are those of the columns in it, from
    0; the width counts words, too. Findings are told what was guessed against the usual, and what
    could not be told. Raise InputError where there are fewer columns than the suffix promises.
    """
    suffix = path.suffix.lower()
    roles = dict(enumerate(_find_first(path, sample, numbers, findings, width)))
    if sample.shape[1] < len(roles):
        raise InputError(
            f"{path}: {sample.shape[1]} columns, a {suffix} file has {' '.join(roles.values())}",
            "give the file the suffix .xyz",
        )
    kinds = {at: _judge(sample[:, at : at + 3]) for at in range(len(roles), sample.shape[1] - 2)}
    if NORMALS[0] not in roles.values():
        _place_normals(kinds, roles)
    if COLOURS[0] not in roles.values():
        _place_colours(sample, kinds, roles, suffix == ".pts")
    _place_zeros(kinds, roles)
    for at, role in roles.items():
        if role in (NORMALS[0], COLOURS[0]) and kinds.get(at) in _DOUBTS:
            columns = f"columns {numbers[at] + 1} to {numbers[at + 2] + 1}"
            findings.warn(f"{columns} have no names and are taken for {_DOUBTS[kinds[at]]}")
    _name_singles(sample, roles, findings)
    return _make_columns([roles[i] for i in range(sample.shape[1])], sample)


def _find_first(
    path: Path, sample: FloatArray, numbers: tuple[int, ...], findings: Findings, width: int
) -> tuple[str, ...]:
    """Return the roles of the first columns: the coordinates, and what the suffix promises."""
    promised = _PROMISED.get(path.suffix.lower(), ())
    if not promised and is_time(sample):
        findings.warn(f"column {numbers[0] + 1} only grows, as the time does, and is taken for it")
        return (_TIME, *AXES)
    is_numbered = numbers[0] > 0
    has_code = len(numbers) == 3 and numbers[-1] + 1 < width
    is_list = is_numbered and (has_code or are_on_map(sample))
    named, told = find_named_order(path), find_order(sample) if is_numbered else ()
    order = named or told or AXES
    if named or order != AXES or (is_list and not told):
        words = ", ".join(_WORDS[axis] for axis in order) if named or told else "x, y, z"
        findings.warn(
            f"columns {numbers[0] + 1} to {numbers[2] + 1} have no names and are taken for {words}:"
            " if they are not, put a line of names in front, as number,y,x,z,code (y is north)"
        )
    return order + promised


def _judge(values: FloatArray) -> _Kind | None:
    """Tell what three columns look like."""
    if not len(values):
        return None
    normals = judge_normals(values)
    if normals in ("unit", "one octant", "encoded"):
        return "normals"
    if normals == "zero":
        return "zeros"
    scale = judge_colours(values[np.isfinite(values).all(axis=1)])
    if scale is not None:
        return scale
    return "vectors" if normals == "any length" else None


def _place(group: tuple[str, ...], at: int, roles: dict[int, str]) -> None:
    roles.update(zip(range(at, at + 3), group, strict=True))


def _find_free(
    kinds: dict[int, _Kind | None], roles: dict[int, str], wanted: tuple[str, ...]
) -> list[int]:
    """Return where there are three columns of a kind that have no role yet."""
    return [
        at
        for at, kind in kinds.items()
        if kind in wanted and not roles.keys() & {at, at + 1, at + 2}
    ]


def _place_normals(kinds: dict[int, _Kind | None], roles: dict[int, str]) -> None:
    for kind in ("normals", "vectors"):
        if places := _find_free(kinds, roles, (kind,)):
            _place(NORMALS, places[0], roles)
            return
    for at in _find_free(kinds, roles, ("zeros",)):
        if kinds.get(at + 3) in _OPAQUE:  # before colours, which zeros could be part of
            _place(NORMALS, at, roles)
            return


def _place_colours(
    sample: FloatArray, kinds: dict[int, _Kind | None], roles: dict[int, str], is_pts: bool
) -> None:
    places = _find_free(kinds, roles, ("8 bit", "16 bit", "float", "zeros"))
    if not any(kinds[at] != "zeros" for at in places):
        return
    at = places[0]
    if at + 1 in places:
        is_alpha = _is_opaque(sample[:, at + 3]) and sample[:, at].any()
        are_four = at == len(roles) and at + 2 not in places and kinds[at + 1] != "float"
        if not is_alpha and (is_pts or are_four):
            at += 1
    _place(COLOURS, at, roles)


def _place_zeros(kinds: dict[int, _Kind | None], roles: dict[int, str]) -> None:
    """Take zeros for normals, or else for colours: who asks for them finds that they are none."""
    for group in (NORMALS, COLOURS):
        places = _find_free(kinds, roles, ("zeros",))
        if places and group[0] not in roles.values():
            _place(group, places[0], roles)


def _is_opaque(values: FloatArray) -> bool:
    return len(values) > 0 and values[0] in _OPAQUE.values() and bool((values == values[0]).all())


def _name_singles(sample: FloatArray, roles: dict[int, str], findings: Findings) -> None:
    for column in range(sample.shape[1]):
        if column not in roles:
            roles[column] = _name_single(sample, column, roles)
    unnamed = [role for role in roles.values() if role.startswith("column_")]
    if unnamed:
        findings.warn(f"without a name, and kept as attributes: {name_some(unnamed)}")


def _name_single(sample: FloatArray, column: int, roles: dict[int, str]) -> str:
    values = sample[:, column]
    if roles.get(column - 1) == COLOURS[-1] and len(values):
        is_share = (
            values.min() >= 0 and values.max() <= 1 and sample[:, column - 3 : column].max() <= 1
        )
        if _is_opaque(values) or is_share:
            return "alpha"
    return "intensity" if "intensity" not in roles.values() else f"column_{column + 1}"


def _make_columns(roles: list[str], sample: FloatArray) -> TableColumns:
    scale = None
    if set(COLOURS) <= set(roles):
        values = sample[:, [roles.index(role) for role in COLOURS]]
        scale = judge_colours(values[np.isfinite(values).all(axis=1)])
    return TableColumns(tuple(roles), scale)
