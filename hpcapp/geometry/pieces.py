"""Connected pieces of a mesh: which of them stay, and which are small beside the largest."""

from __future__ import annotations

from math import inf

import numpy as np

from hpcapp.geometry.points import BoolArray, FloatArray
from hpcapp.wording import say_count, say_number, say_share
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError
from hpccomponent.ranges import check_range

SMALL = 0.003
"""Of the area of the largest piece: a piece with less is small. ``benchmarks/decisions.py`` shows
what it parts: furniture, roofs and statuettes have 0.0087 or more of the room, town or table that
they are scanned with; shreds of them have 0.0009 or less."""


_BITS = 24


@dataclass(frozen=True, slots=True)
class PieceChoice:
    """Which pieces of a mesh stay.

    `most` is how many, the largest ones by their area; none stays with an area below `smallest`.
    """

    most: int | None = None
    smallest: float | None = None

    @property
    def is_something(self) -> bool:
        """Whether anything is asked for."""
        return self.most is not None or self.smallest is not None

    def check(self) -> None:
        """Refuse numbers out of their range, by a UsageError before the work."""
        if self.most is not None and not (isinstance(self.most, int) and self.most >= 1):
            raise UsageError(f"{name_option('pieces')} is {self.most!r}", "give 1 or more")
        if self.smallest is not None:
            check_range(name_option("smallest"), self.smallest, 0.0, inf, is_open=True)

    def choose(self, areas: FloatArray) -> BoolArray:
        """Tell which pieces of areas (c,) stay: of equal ones, the first.

        Raise UsageError where none does.
        """
        stays = areas >= (self.smallest or 0.0)
        if not stays.any() and len(areas):
            largest = say_number(float(areas.max()))
            raise UsageError(
                f"no piece of the mesh is as large as {self.smallest:g}: the largest has {largest}",
                f"give a smaller {name_option('smallest')}",
            )
        stays[np.argsort(-areas, kind="stable")[self.most or len(areas) :]] = False
        return stays


def round_areas(areas: FloatArray) -> FloatArray:
    """Return areas with the 24 bits that sums in any order agree on, whatever their size.

    Examples
    --------
    >>> round_areas(np.array([1e66, 1 / 3, 1e-66, 0.0])).tolist()
    [9.99999955349436e+65, 0.3333333432674408, 1.0000000340842266e-66, 0.0]
    """
    shares, powers = np.frexp(areas)
    rounded: FloatArray = np.ldexp(np.rint(shares * (1 << _BITS)) / (1 << _BITS), powers)
    return rounded


def find_small(areas: FloatArray) -> BoolArray:
    """Tell which pieces of a mesh are small beside the largest.

    Examples
    --------
    >>> find_small(np.array([0.1, 100.0, 5.0])).tolist()
    [True, False, False]
    """
    is_small: BoolArray = areas < SMALL * areas.max(initial=0.0)
    return is_small


def say_small(areas: FloatArray, is_small: BoolArray) -> str:
    """Say how many pieces of a mesh are small, and what drops them.

    Examples
    --------
    >>> areas = np.array([0.1, 100.0, 5.0])
    >>> say_small(areas, find_small(areas))
    '1 of 3 pieces is small, 0.1 % of the area: pieces=2 drops it'
    """
    count = int(is_small.sum())
    share = _say_part(areas, is_small)
    option = name_option("pieces", len(areas) - count)
    words = ("is small", "it") if count == 1 else ("are small", "them")
    return (
        f"{count:,} of {len(areas):,} pieces {words[0]}, {share} of the area: "
        f"{option} drops {words[1]}"
    )


def say_dropped(areas: FloatArray, stays: BoolArray) -> str:
    """Say how many pieces of a mesh are dropped.

    Examples
    --------
    >>> say_dropped(np.array([0.1, 100.0, 5.0]), np.array([False, True, False]))
    'dropped 2 of 3 pieces, 4.9 % of the area'
    >>> say_dropped(np.zeros(3), np.array([False, True, False]))
    'dropped 2 of 3 pieces, 0 % of the area'
    """
    share = _say_part(areas, ~stays)
    dropped = int((~stays).sum())
    return f"dropped {dropped:,} of {say_count(len(areas), 'piece')}, {share} of the area"


def _say_part(areas: FloatArray, chosen: BoolArray) -> str:
    """Say which part of the area some pieces have; they may all be without any."""
    whole = float(areas.sum())
    return say_share(float(areas[chosen].sum()) / whole if whole else 0.0)
