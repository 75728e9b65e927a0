"""Columns beside the coordinates, as properties of a binary PLY file."""

from __future__ import annotations

from collections.abc import Container

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import PointCloud
from hpcapp.io.columns import Numbers
from hpcapp.io.ply.header import SCALAR_TYPES
from hpcapp.io.points.column_roles import COLOURS, NORMALS
from hpccomponent.dataclass import dataclass

_NAMES = {dtype: name for name, dtype in reversed(SCALAR_TYPES.items())}
_TAKEN = ("x", "y", "z", *NORMALS, *COLOURS)


@dataclass(frozen=True, slots=True)
class VertexProperties:
    """The properties that follow on the coordinates.

    Names are as PLY spells them: without blanks, in ASCII, each once; types are numpy's,
    little-endian.
    """

    names: tuple[str, ...]
    types: tuple[str, ...]

    @classmethod
    def of(cls, points: PointCloud) -> VertexProperties:
        """Return the properties for what some points have, with the types of their attributes.

        Whole numbers of 64 bits, which PLY lacks, become ``double``.
        """
        names: dict[str, None] = {}  # in their order
        types: list[str] = []
        if points.normals is not None:
            names |= dict.fromkeys(NORMALS)
            types += ["<f4"] * 3
        if points.colours is not None:
            names |= dict.fromkeys(COLOURS)
            types += [choose_type(points.colours.dtype)] * 3
        for name, column in points.attributes.items():
            names[_spell(name, names)] = None
            types.append(choose_type(column.dtype))
        return cls(tuple(names), tuple(types))

    @property
    def lines(self) -> list[str]:
        """What the header says of them."""
        return [
            f"property {name_type(dtype)} {name}"
            for name, dtype in zip(self.names, self.types, strict=True)
        ]

    @property
    def fields(self) -> list[tuple[str, str]]:
        """Fields of a structured type, in their order."""
        return list(zip(self.names, self.types, strict=True))

    def fill(self, rows: NDArray[np.void], points: PointCloud) -> None:
        """Fill these fields of some rows with the columns that the properties were made for."""
        columns: list[Numbers] = []
        if points.normals is not None:
            columns += list(points.normals.T)
        if points.colours is not None:
            columns += list(points.colours.T)
        columns += points.attributes.values()
        with np.errstate(over="ignore"):  # what float cannot hold becomes infinite
            for name, column in zip(self.names, columns, strict=True):
                rows[name] = column


def _spell(name: str, taken: Container[str]) -> str:
    """Return a name as PLY can have it, and that no other property has."""
    plain = "".join(c if c.isascii() and c.isprintable() and c != " " else "_" for c in name)
    spelled, number = plain or "_", 2
    while spelled in taken or spelled in _TAKEN:
        spelled, number = f"{plain}_{number}", number + 1
    return spelled


def choose_type(dtype: np.dtype[np.generic]) -> str:
    """Return the type that numbers are written as: of numpy, little-endian.

    Whole numbers of 64 bits, which PLY lacks, become float64.
    """
    code = {"b1": "u1", "f2": "f4"}.get(dtype.str[1:], dtype.str[1:])
    if code not in _NAMES:
        code = "f8"
    return code if code.endswith("1") else f"<{code}"


def name_type(dtype: str) -> str:
    """Return what PLY calls a type of `choose_type`."""
    return _NAMES[dtype.lstrip("<|")]
