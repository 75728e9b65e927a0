"""What ``--attributes`` asks for.

This module is imported for every ``--help``: nothing heavy is imported.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError

if TYPE_CHECKING:
    from hpcapp.geometry.mesh import Mesh
    from hpcapp.geometry.points import PointCloud


_COLOURS = ("colours", "colors", "rgb")
_MADE = ("normals", "support")
CONFIDENCE = "confidence"
"""Attribute of a point whose normal was turned to a side: how sure this is, 0 to 1."""

_OF_THE_SCAN = ("scan", "row", "column")  # which say where a point stands in the file


@dataclass(frozen=True, slots=True)
class AttributeChoice:
    """Which attributes a mesh's vertices get.

    The columns of the points by their `names`, of which ``colours`` are three; all where `is_auto`,
    but for those that number scans, rows and columns, and colours alone for a texture
    (`is_picture`). Beside these normals of the vertices, distances of the nearest points, and,
    where normals are estimated or mended, how sure their sides are.
    """

    is_auto: bool = True
    names: tuple[str, ...] = ()
    has_normals: bool = False
    has_support: bool = False
    has_confidence: bool = False
    is_picture: bool = False

    def for_texture(self) -> AttributeChoice:
        """Return what of it a texture holds, in place of the vertices.

        Raises UsageError where something else is asked for by its name.
        """
        is_plain = not (self.has_normals or self.has_support or self.has_confidence)
        if not is_plain or set(self.names) - {_COLOURS[0]}:
            raise UsageError(
                f"--texture holds colours, and no other {name_option('attributes')}",
                "name auto, none or colours, or leave the texture out",
            )
        return replace(self, is_picture=True)

    def name_confidence(self, layout: PointCloud) -> str | None:
        """Return by which name points keep how sure their sides are; None where they need not.

        `layout` is what the input has already.
        """
        is_needed = self.has_confidence and CONFIDENCE not in layout.attributes
        return CONFIDENCE if is_needed else None

    def select(self, cloud: PointCloud, source: str) -> PointCloud:
        """Leave out the columns that are not asked for; positions and normals stay.

        Raises UsageError where a column that is asked for is not there: it names `source`, the
        file, and those that are.
        """
        known = list(cloud.attributes)
        if cloud.colours is not None:
            known.insert(0, _COLOURS[0])
        _check_known(self.names, known, source, f"; {' and '.join(_MADE)} can always be had")
        automatic = [name for name in known if self.is_auto and self._suits(name)]
        wanted = {*self.names, *automatic, *[CONFIDENCE] * self.has_confidence}
        return replace(
            cloud,
            colours=cloud.colours if _COLOURS[0] in wanted else None,
            attributes={name: c for name, c in cloud.attributes.items() if name in wanted},
        )

    @property
    def named(self) -> tuple[str, ...]:
        """All that is asked for by its name, made or not."""
        asked = (self.has_normals, self.has_support, self.has_confidence)
        made = zip((*_MADE, CONFIDENCE), asked, strict=True)
        return (*self.names, *(name for name, is_asked in made if is_asked))

    def select_of_mesh(self, mesh: Mesh, source: str) -> Mesh:
        """Leave out what the vertices of a mesh have and is not asked for; nothing is made.

        Raises UsageError as `select` does.
        """
        has = {_MADE[0]: mesh.normals is not None, _COLOURS[0]: mesh.colours is not None}
        known = [name for name, is_there in has.items() if is_there] + list(mesh.attributes)
        _check_known(self.named, known, source)
        wanted = set(known) if self.is_auto else set(self.named)
        return replace(
            mesh,
            normals=mesh.normals if _MADE[0] in wanted else None,
            colours=mesh.colours if _COLOURS[0] in wanted else None,
            attributes={name: c for name, c in mesh.attributes.items() if name in wanted},
        )

    def _suits(self, name: str) -> bool:
        return name == _COLOURS[0] if self.is_picture else name not in _OF_THE_SCAN


def _check_known(names: Iterable[str], known: list[str], source: str, made: str = "") -> None:
    """Refuse the names of columns that are not there; `made` says what is there besides."""
    for name in names:
        if name not in known:
            raise UsageError(
                f"{name_option('attributes', name)}: there is no such column",
                f"{source} has {', '.join(known) if known else 'no other columns'}{made}",
            )


def parse_attributes(text: str) -> AttributeChoice:
    """Return what ``--attributes`` asks for: ``none``, or names with commas between them.

    Of these ``auto`` means all columns, ``normals`` and ``support`` what is made for the vertices,
    and ``confidence`` what is found with the points' normals. Raises UsageError where a name is
    empty, or stands beside ``none``.

    Examples
    --------
    >>> choice = parse_attributes("auto,normals,intensity")
    >>> choice.is_auto, choice.names, choice.has_normals, choice.has_support
    (True, ('intensity',), True, False)
    """
    words = [word.strip() for word in text.split(",")]
    if not all(words):
        raise UsageError(
            f"{name_option('attributes', text)} holds an empty name",
            "give auto, none, or names as a,b,c",
        )
    if "none" in words:
        if len(words) > 1:
            raise UsageError(
                f"{name_option('attributes', text)}: none excludes all others",
                "leave it out, or give it alone",
            )
        return AttributeChoice(is_auto=False)
    names = [_COLOURS[0] if word.lower() in _COLOURS else word for word in words]
    made = ("auto", CONFIDENCE, *_MADE)
    own = tuple(dict.fromkeys(name for name in names if name not in made))
    has_normals, has_support, has_confidence = (word in words for word in (*_MADE, CONFIDENCE))
    return AttributeChoice("auto" in words, own, has_normals, has_support, has_confidence)
