"""A mesh that is there, mended: its holes filled, then its pieces chosen, then cut."""

from __future__ import annotations

import logging
from dataclasses import field

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.pieces import PieceChoice, find_small, say_dropped, say_small
from hpcapp.mending.holes import fill_holes
from hpcapp.mending.pieces import keep_faces, measure_pieces
from hpcapp.parts.crop import Crop
from hpcapp.wording import say_count
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

log = logging.getLogger("hpcapp")


@dataclass(frozen=True, slots=True)
class Mending:
    """What is asked of a mesh that is there.

    Holes up to a size are filled: the diagonal of the box around a border. Where nothing is chosen,
    small pieces are named. The crop is in the coordinates of the mesh.
    """

    fill_holes: float | None = None
    choice: PieceChoice = field(default_factory=PieceChoice)
    crop: Crop = field(default_factory=Crop)

    @property
    def is_something(self) -> bool:
        """Whether anything is asked for."""
        return self.fill_holes is not None or self.choice.is_something or self.crop.has_region


def mend_mesh(mesh: Mesh, asked: Mending, height_unit: float = 1.0, name: str = "the mesh") -> Mesh:
    """Fill holes of a mesh, drop pieces of it, and cut it; a unit of z is so many of x and y.

    Raise UsageError where no piece is as large as was asked for, and InputError where the mesh has
    no faces, or places that are none, or nothing where it is to be cut.
    """
    _check(mesh)
    if asked.fill_holes is not None:
        mesh = _fill(mesh, asked.fill_holes)
    return asked.crop.cut(_choose(mesh, asked.choice), height_unit, name)


def _check(mesh: Mesh) -> None:
    """Refuse what is no surface."""
    if not len(mesh.faces):
        raise InputError("the mesh has no faces", "give one that has some")
    is_bad = ~np.isfinite(mesh.vertices).all(axis=1)
    if is_bad.any():
        raise InputError(
            f"vertex {int(np.argmax(is_bad))} of the mesh is NaN or infinite",
            "write the mesh anew without it",
        )


def _fill(mesh: Mesh, size: float) -> Mesh:
    filled = fill_holes(mesh, size)
    log.info("filled %s", say_count(filled.holes, "hole"))
    if filled.left:
        log.warning(
            "warning: %s up to %g left open, where the mesh is not manifold",
            say_count(filled.left, "border"), size,
        )  # fmt: skip
    return filled.mesh


def _choose(mesh: Mesh, choice: PieceChoice) -> Mesh:
    pieces, areas = measure_pieces(mesh)
    if not choice.is_something:
        is_small = find_small(areas)
        if is_small.any():
            log.info("%s", say_small(areas, is_small))
        return mesh
    stays = choice.choose(areas)
    log.info("%s", say_dropped(areas, stays))
    return keep_faces(mesh, stays[pieces])
