"""What ``--viewpoint`` asks for.

This module is imported for every ``--help``: nothing heavy is imported.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Literal, cast, get_args

from hpccomponent.cli.option_names import name_option
from hpccomponent.errors import UsageError
from hpccomponent.ranges import FARTHEST, is_place

Direction = Literal["above", "below", "inside", "outside"]
Place = (
    tuple[float, float, float]
    | tuple[float, float, float, float]
    | tuple[float, float, float, float, float, float]
)
"""Coordinates; of a path also the time; of a camera also the direction along which it looks."""

Viewpoint = Direction | tuple[Place, ...]
"""From which direction points were measured, or from which places; no places: nobody has said."""

TIMED = 4  # numbers of a place of a path: x, y, z and the time
_DIRECTIONS: tuple[Direction, ...] = get_args(Direction)


def parse_viewpoint(words: Sequence[str]) -> Viewpoint:
    """Parse what was typed; read the files of trajectories and cameras.

    A direction stands alone (else UsageError, as for unknown words); places are ``X,Y,Z``, those of
    a path ``X,Y,Z@TIME``, cameras ``X,Y,Z,DX,DY,DZ``, or names of files. InputError where one is of
    neither kind.

    Examples
    --------
    >>> parse_viewpoint(["above"]), parse_viewpoint(["1.5,0,-2"])
    ('above', ((1.5, 0.0, -2.0),))
    """
    for direction in _DIRECTIONS:
        if direction in words:
            if set(words) != {direction}:
                raise UsageError(
                    f"{name_option('viewpoint', direction)} stands beside another one",
                    "give it alone",
                )
            return direction
    return tuple(place for word in words for place in _parse_places(word))


def type_viewpoint(viewpoint: Viewpoint) -> list[str]:
    """Return words of the command line that say the same without a file."""
    if isinstance(viewpoint, str):
        return ["--viewpoint", viewpoint]
    return [w for place in viewpoint for w in ("--viewpoint", _type_place(place))]


def _type_place(place: Place) -> str:
    word = ",".join(map(repr, place))
    return "@".join(word.rsplit(",", 1)) if len(place) == TIMED else word


def _parse_places(word: str) -> tuple[Place, ...]:
    place, is_timed, time = word.partition("@")
    try:
        numbers = tuple(float(number) for number in place.split(","))
        times = (float(time),) if is_timed else ()
    except ValueError:
        path = Path(word)
        if word and (path.is_file() or path.is_dir()):
            return _read_places(path)
    else:
        if (len(numbers), len(times)) in ((3, 0), (3, 1), (6, 0)) and (
            is_place(*numbers) and all(map(isfinite, times))
        ):
            return (cast(Place, (*numbers, *times)),)
    raise UsageError(
        f"{name_option('viewpoint', word)} is neither {', '.join(_DIRECTIONS)}, nor three numbers "
        f"up to {FARTHEST:.0e}, nor a file of a trajectory or of cameras",
        "give where the sensor was, as 1.5,0,-2",
    )


def _read_places(path: Path) -> tuple[Place, ...]:
    from hpcapp.io.cameras.formats import find_camera_file, read_places  # numpy takes its time
    from hpcapp.io.text.endings import warn_of_cut
    from hpcapp.io.text.trajectory import read_trajectory

    path = find_camera_file(path)
    cameras = read_places(path)
    rows = read_trajectory(path) if cameras is None else cameras
    warn_of_cut(path)
    return tuple(cast(Place, tuple(row)) for row in rows.tolist())
