"""What may be asked of a print.

This module is imported for every ``--help``: nothing heavy is imported.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from hpcapp.applications.surface.methods.options import make_click_options, option, option_names
from hpcapp.extras import require_library
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError

MILLIMETRES = {
    "mm": 1.0,
    "cm": 10.0,
    "m": 1000.0,
    "km": 1e6,
    "in": 25.4,
    "ft": 304.8,
    "US ft": 1.2e6 / 3937,
}
"""How many of them a unit of length is."""

GROUP = "Print"
SUFFIXES = (".stl", ".3mf", ".obj", ".ply")
"""Of the files that slicers read, in millimetres."""

_FEWEST, _MOST = 1e-6, 1e6  # of scales, and of lengths in millimetres: beyond them digits are lost
_DEFAULT_WALL = "2mm"


@dataclass(frozen=True, slots=True)
class PrintOptions:
    """The options of a print, as they are typed."""

    is_print: bool = option(
        False,
        "Make a print of it: closed, in one piece, with a flat base where it stands, in "
        "millimetres; into a .stl, .3mf, .obj or .ply.",
        group=GROUP, words=("--print",),
    )  # fmt: skip
    scale: str | None = option(
        None,
        "With --print: its scale, 1:10.  [default: the largest round one up to 1:1 that fits into "
        "250 mm; 100 mm along the longest side where no unit is known]",
        group=GROUP, metavar="1:N",
    )  # fmt: skip
    height: str | None = option(
        None,
        "With --print: its height, 120mm.",
        group=GROUP, metavar="LENGTH", replaces=("scale",),
    )  # fmt: skip
    unit: str | None = option(
        None,
        "With --print: the unit of the input's coordinates.  [default: as its file says]",
        group=GROUP, choices=("mm", "cm", "m", "km", "in", "ft"),
    )  # fmt: skip
    wall: str = option(
        _DEFAULT_WALL,
        "With --print: how thick an open surface is made, and least what is below a terrain.",
        group=GROUP, metavar="LENGTH",
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Printing:
    """What is asked of a print.

    Parameters
    ----------
    scale : float or None
        Of the print to what it is of: 0.1 for 1:10.
    height : float or None
        In millimetres.
    unit : str or None
        Of the input, of `MILLIMETRES`, where the user says it.
    wall : float
        Least thickness that an open surface is given, in millimetres.
    """

    scale: float | None = None
    height: float | None = None
    unit: str | None = None
    wall: float = 2.0

    def find_unit(self, stated: str | None) -> float | None:
        """Return the millimetres of a unit of the input, which its file may state; None if unknown.

        Raise UsageError where it is none of length, or unknown and a scale is asked for.
        """
        name = self.unit or stated
        if name is not None and name not in MILLIMETRES:
            raise UsageError(
                f"the unit of the input is {name}, which is no length",
                f"project it to metres, or give {name_option('unit', 'm')}",
            )
        if name is None and self.scale is not None:
            raise UsageError(
                "the unit of the input is not known, and so no scale of it",
                f"give {name_option('unit', 'm')}, too, or {name_option('height', '120mm')}",
            )
        return None if name is None else MILLIMETRES[name]


NAMES = option_names(PrintOptions)


def add_print_options(command: click.Command) -> click.Command:
    """Give a command the options of a print, before its own."""
    first, *others = command.params
    command.params = [first, *make_click_options(PrintOptions), *others]
    return command


def take_printing(typed: dict[str, Any]) -> Printing | None:
    """Take the options of a print out of those that were typed; None where none is asked for.

    Raise UsageError where they are wrong, or mean nothing with the others, and MissingLibraryError
    where the library is not here.
    """
    options = PrintOptions(**{name: typed.pop(name) for name in NAMES})
    if not options.is_print:
        for name in NAMES[1:]:
            if getattr(options, name) not in (None, _DEFAULT_WALL):
                raise UsageError(f"--{name} means nothing without --print", "give --print, too")
        return None
    _check_others(typed)
    return make_printing(options.scale, options.height, options.unit, options.wall)


def _check_others(typed: Mapping[str, Any]) -> None:
    if Path(typed["output"]).suffix.lower() not in SUFFIXES:
        raise UsageError(
            f"{typed['output']}: no slicer reads it in millimetres",
            f"--print writes {', '.join(SUFFIXES)}",
        )
    for name in ("size", "texture"):
        if typed.get(name) is not None:
            raise UsageError(f"--print and --{name} exclude each other", "give --faces")
    if typed["origin"] != "auto":
        raise UsageError("--print and --origin exclude each other", "a print lies at zero")


def make_printing(
    scale: str | None = None,
    height: str | float | None = None,
    unit: str | None = None,
    wall: str | float = _DEFAULT_WALL,
) -> Printing:
    """Return what is asked of a print; numbers are millimetres.

    UsageError where something is none, MissingLibraryError where the library is not here.

    Examples
    --------
    >>> make_printing("1:20"), make_printing(height="12cm").height
    (Printing(scale=0.05, height=None, unit=None, wall=2.0), 120.0)
    """
    words = f"{name_option('print')} needs the package manifold3d"
    require_library("manifold3d", words, "print")
    if scale is not None and height is not None:
        words = f"{name_option('scale')} and {name_option('height')} exclude each other"
        raise UsageError(words, "give one of them")
    if unit is not None and unit not in MILLIMETRES:
        raise UsageError(f"unit is {unit!r}", f"choose {' or '.join(MILLIMETRES)}")
    tall = None if height is None else _parse_length("height", height)
    return Printing(
        None if scale is None else _parse_scale(scale), tall, unit, _parse_length("wall", wall)
    )


def _parse_scale(text: str) -> float:
    match = re.fullmatch(r"([0-9.]+):([0-9.]+)", text)
    try:
        printed, true = (float(number) for number in match.groups()) if match else (0.0, 0.0)
        scale = printed / true
    except (ValueError, ZeroDivisionError):
        scale = 0.0
    if not _FEWEST <= scale <= _MOST:
        asked = name_option("scale", text)
        raise UsageError(f"{asked}: is no scale", "give 1:10 for a tenth, or 2:1 for twice")
    return scale


def _parse_length(name: str, asked: str | float) -> float:
    """Return a length in millimetres."""
    match = re.fullmatch(r"([0-9.]+) ?(mm|cm|m|in|ft)?", str(asked))
    try:
        length = float(match[1]) * MILLIMETRES[match[2] or "mm"] if match else 0.0
    except ValueError:
        length = 0.0
    if not _FEWEST <= length <= _MOST:
        raise UsageError(f"{name_option(name, asked)}: is no length", "give it as 120mm or 4.5in")
    return length
