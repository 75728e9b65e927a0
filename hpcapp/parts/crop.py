"""What ``--box``, ``--around``, ``--polygon`` and the options of classes ask for.

This module is imported for every ``--help``: nothing heavy is imported.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from os import PathLike, fspath
from typing import TYPE_CHECKING, TypeVar

from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError, UsageError
from hpccomponent.ranges import FARTHEST, is_place

if TYPE_CHECKING:
    from hpcapp.geometry.mesh import Mesh
    from hpcapp.geometry.regions.region import Area
    from hpcapp.io import PointSource

Number = TypeVar("Number", int, float)

CROPPED = ("box", "around", "polygon", "classes", "not_classes", "ground")
"""Options by which a part is asked for, as `parse_crop` takes them."""

_BOX, _BALL = 6, 4  # numbers
_LAST_CLASS = 255


@dataclass(frozen=True, slots=True)
class Crop:
    """The part of a scan that is asked for, in its coordinates; all of it by default.

    Parameters
    ----------
    box : tuple of float
        x, y and z of two corners, or none.
    around : tuple of float
        x, y, z of a place and a distance from it, or none.
    polygon : str
        Polygons in WKT, of which all heights are meant, or none.
    classes : tuple of int
        The only ones; all where there are none.
    ground : bool
        Whether only the bare ground is asked for.
    """

    box: tuple[float, ...] = ()
    around: tuple[float, ...] = ()
    polygon: str = ""
    classes: tuple[int, ...] = ()
    not_classes: tuple[int, ...] = ()
    ground: bool = False

    @property
    def has_region(self) -> bool:
        """Whether only a place is asked for."""
        return bool(self.box or self.around or self.polygon)

    @property
    def keeps_noise(self) -> bool:
        """Whether classes of noise are asked for by their numbers."""
        from hpcapp.io.las.layout import NOISE  # numpy takes its time

        return not set(NOISE).isdisjoint(self.classes)

    def find_region(self, height_unit: float) -> Area:
        """Return the part, given how long a unit of z is in units of x and y."""
        import numpy as np

        from hpcapp.geometry.regions.prism import Prism
        from hpcapp.geometry.regions.region import Region

        if self.polygon:
            return Prism.of_text(self.polygon)
        if self.box:
            return Region.box(np.array(self.box[:3]), np.array(self.box[3:]), height_unit)
        return Region.ball(np.array(self.around[:3]), self.around[3], height_unit)

    def narrow(self, source: PointSource, margin: float = 0.0) -> PointSource:
        """Return the points of a source that are asked for by place and class.

        It is opened with the noise, if `keeps_noise`; the margin is that of `PointSource.within`.
        """
        if self.has_region:
            source = source.within(self.find_region(source.frame.height_scale), margin)
        if self.classes or self.not_classes:
            source = source.of_classes(self.classes, self.not_classes)
        return source

    def take(self, source: PointSource, margin: float = 0.0) -> PointSource:
        """Return the same, of which the bare ground alone where that is asked for."""
        source = self.narrow(source, margin)
        if not self.ground:
            return source
        from hpcapp.parts.ground import take_ground

        return take_ground(source, (self, margin))

    def cut(self, mesh: Mesh, height_unit: float, name: str) -> Mesh:
        """Return what of a mesh, in the unit of its file, lies where only a place is asked for.

        Raise InputError where there is nothing.
        """
        import numpy as np

        from hpcapp.geometry.bounds import bound_points
        from hpcapp.geometry.regions.clipping import clip_mesh
        from hpcapp.geometry.regions.region import say_place

        if not self.has_region:
            return mesh
        region, scales = self.find_region(height_unit), np.array([1.0, 1.0, height_unit])
        isotropic = replace(mesh, vertices=mesh.vertices * scales)
        part = clip_mesh(isotropic, region.localise(mesh.origin * scales))
        if not len(part.faces):
            low, high = (end + mesh.origin for end in bound_points(mesh.vertices))
            raise InputError(
                f"{name}: no surface in {region}",
                f"the mesh lies from {say_place(low)} to {say_place(high)}",
            )
        return replace(part, vertices=part.vertices / scales)


EVERYTHING = Crop()


def make_crop(
    box: Sequence[float] | None = None,
    around: Sequence[float] | None = None,
    polygon: str | PathLike[str] | None = None,
    classes: Sequence[int] | None = None,
    not_classes: Sequence[int] | None = None,
    ground: bool = False,
) -> Crop:
    """Return what numbers and a file of polygons ask for.

    Raise UsageError where there are not as many as it takes, one is none, they hold nothing, or
    exclude each other, and what `read_outline` raises.
    """
    _refuse_two(classes=classes, not_classes=not_classes)
    _refuse_two(classes=classes, ground=ground or None)
    _refuse_two(box=box, around=around, polygon=polygon)
    chosen = Crop(
        classes=_check_classes("classes", classes),
        not_classes=_check_classes("not_classes", not_classes),
        ground=ground,
    )
    if box is not None:
        _check("box", box, _BOX, "two corners as X0,Y0,Z0,X1,Y1,Z1")
        if any(a == b for a, b in zip(box[:3], box[3:], strict=True)):
            raise UsageError(
                f"{name_option('box')}: the corners have a coordinate in common, so that nothing "
                "is between them",
                "give two opposite corners",
            )
        return replace(chosen, box=tuple(map(float, box)))
    if around is not None:
        _check("around", around, _BALL, "a place and a distance as X,Y,Z,R")
        if not around[3] > 0.0:
            raise UsageError(f"{name_option('around')}: R is {around[3]:g}", "give more than 0")
        return replace(chosen, around=tuple(map(float, around)))
    if polygon is not None:
        from hpcapp.io.outlines import read_outline

        return replace(chosen, polygon=read_outline(fspath(polygon)))
    return chosen


def _refuse_two(**given: object) -> None:
    names = [name_option(name) for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise UsageError(f"{' and '.join(names)} exclude each other", "give one of them")


def parse_crop(
    box: str | None = None,
    around: str | None = None,
    polygon: str | None = None,
    classes: str | None = None,
    not_classes: str | None = None,
    ground: bool = False,
) -> Crop:
    """Return what was typed; errors as of `make_crop`.

    Examples
    --------
    >>> parse_crop("0,0,0,1,2,3").box
    (0.0, 0.0, 0.0, 1.0, 2.0, 3.0)
    """
    return make_crop(
        _parse("box", box, float, "1.5,0,-2"),
        _parse("around", around, float, "1.5,0,-2"),
        polygon,
        _parse("classes", classes, int, "2,6"),
        _parse("not_classes", not_classes, int, "2,6"),
        ground,
    )


def _parse(
    name: str, text: str | None, kind: Callable[[str], Number], example: str
) -> list[Number] | None:
    if text is None:
        return None
    try:
        return [kind(number) for number in text.split(",")]
    except ValueError:
        what = "numbers" if kind is float else "whole numbers"
        raise UsageError(
            f"{name_option(name, text)}: these are no {what}", f"write them as {example}"
        ) from None


def _check_classes(name: str, classes: Sequence[int] | None) -> tuple[int, ...]:
    if classes is None:
        return ()
    if not classes or not all(0 <= one <= _LAST_CLASS for one in classes):
        raise UsageError(
            f"{name_option(name)} has {','.join(map(str, classes)) or 'none'}",
            f"give numbers of classes from 0 to {_LAST_CLASS}",
        )
    return tuple(map(int, classes))


def _check(name: str, numbers: Sequence[float], count: int, what: str) -> None:
    if len(numbers) != count or not is_place(*numbers):
        raise UsageError(
            f"{name_option(name)} has {','.join(f'{n:.9g}' for n in numbers)}, not {count} numbers "
            f"up to {FARTHEST:.0e}",
            f"give {what}",
        )
