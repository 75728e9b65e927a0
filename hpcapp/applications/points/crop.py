"""What ``--box`` and ``--around`` ask for.

This module is imported for every ``--help``: nothing heavy is imported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hpccomponent.cli.option_names import name_option
from hpccomponent.errors import UsageError
from hpccomponent.ranges import FARTHEST, is_place

if TYPE_CHECKING:
    from hpcapp.geometry.region import Region
    from hpcapp.io import PointSource

_BOX, _BALL = 6, 4  # numbers


@dataclass(frozen=True, slots=True)
class Crop:
    """The part of a scan that is asked for, in its coordinates; all of it by default.

    Parameters
    ----------
    box : tuple of float
        x, y and z of two corners; none where no box is asked for.
    around : tuple of float
        x, y, z of a place and a distance from it, or none.
    """

    box: tuple[float, ...] = ()
    around: tuple[float, ...] = ()

    @property
    def is_something(self) -> bool:
        """Whether only a part is asked for."""
        return bool(self.box or self.around)

    def find_region(self, height_unit: float) -> Region:
        """Return the part, given how long a unit of z is in units of x and y."""
        import numpy as np

        from hpcapp.geometry.region import Region

        if self.box:
            return Region.box(np.array(self.box[:3]), np.array(self.box[3:]), height_unit)
        return Region.ball(np.array(self.around[:3]), self.around[3], height_unit)

    def take(self, source: PointSource, margin: float = 0.0) -> PointSource:
        """Return the points of a source that are asked for: see `PointSource.within`."""
        if not self.is_something:
            return source
        return source.within(self.find_region(source.frame.height_scale), margin)


def make_crop(box: Sequence[float] | None, around: Sequence[float] | None) -> Crop:
    """Return what numbers ask for.

    Raises
    ------
    UsageError
        There are not as many as it takes, one is none, or they hold nothing.
    """
    if box is not None and around is not None:
        raise UsageError(
            f"{name_option('box')} and {name_option('around')} exclude each other",
            "give one of them",
        )
    if box is not None:
        _check("box", box, _BOX, "two corners as X0,Y0,Z0,X1,Y1,Z1")
        if any(a == b for a, b in zip(box[:3], box[3:], strict=True)):
            raise UsageError(
                f"{name_option('box')}: the corners have a coordinate in common, so that nothing "
                "is between them",
                "give two opposite corners",
            )
        return Crop(box=tuple(map(float, box)))
    if around is not None:
        _check("around", around, _BALL, "a place and a distance as X,Y,Z,R")
        if not around[3] > 0.0:
            raise UsageError(f"{name_option('around')}: R is {around[3]:g}", "give more than 0")
        return Crop(around=tuple(map(float, around)))
    return Crop()


def parse_crop(box: str | None, around: str | None) -> Crop:
    """Return what was typed; errors as of `make_crop`.

    Examples
    --------
    >>> parse_crop("0,0,0,1,2,3", None).box
    (0.0, 0.0, 0.0, 1.0, 2.0, 3.0)
    """
    return make_crop(_parse("box", box), _parse("around", around))


def _parse(name: str, text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(number) for number in text.split(",")]
    except ValueError:
        raise UsageError(
            f"{name_option(name, text)}: these are no numbers", "write them as 1.5,0,-2"
        ) from None


def _check(name: str, numbers: Sequence[float], count: int, what: str) -> None:
    if len(numbers) != count or not is_place(*numbers):
        raise UsageError(
            f"{name_option(name)} has {','.join(f'{n:.9g}' for n in numbers)}, not {count} numbers "
            f"up to {FARTHEST:.0e}",
            f"give {what}",
        )
