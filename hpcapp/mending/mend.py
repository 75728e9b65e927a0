"""A mesh that is there, mended: its holes filled, then cut, then its pieces chosen."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import field

import numpy as np

from hpcapp.applications.surface.boundary.lengths import Length
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.pieces import PieceChoice, find_small, say_dropped, say_small
from hpcapp.mending.holes import fill_holes
from hpcapp.mending.pieces import keep_faces, measure_pieces
from hpcapp.parts.crop import Crop
from hpcapp.progress import Progress, StageClock
from hpcapp.wording import say_count
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

log = logging.getLogger("hpcapp")


@dataclass(frozen=True, slots=True)
class Mending:
    """What is asked of a mesh that is there.

    Holes up to a size are filled: the diagonal of the box around a border; a spacing is the median
    edge. Where nothing is chosen, small pieces are named. The crop is in the coordinates of the
    mesh.
    """

    fill_holes: Length | None = None
    choice: PieceChoice = field(default_factory=PieceChoice)
    crop: Crop = field(default_factory=Crop)

    @property
    def is_something(self) -> bool:
        """Whether anything is asked for."""
        return self.fill_holes is not None or self.choice.is_something or self.crop.has_region


def mend_mesh(
    mesh: Mesh,
    asked: Mending,
    height_unit: float = 1.0,
    name: str = "the mesh",
    clock: StageClock | None = None,
) -> Mesh:
    """Fill holes of a mesh, cut it, and drop pieces of it; a unit of z is so many of x and y.

    The clock is told how far the filling has come. Raise UsageError where no piece is as large as
    was asked for, and InputError where the mesh has no faces, or places that are none, or nothing
    where it is to be cut.
    """
    _check(mesh)
    if asked.fill_holes is not None:
        clock = clock or StageClock(Progress())
        with clock.stage("fill holes"):
            mesh = _fill(mesh, asked.fill_holes, clock.progress.advance)
    return _choose(asked.crop.cut(mesh, height_unit, name), asked.choice)


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


def _fill(mesh: Mesh, length: Length, advance: Callable[[int, int], None]) -> Mesh:
    size = length.value * (_measure_edge(mesh) if length.in_spacings else 1.0)
    filled = fill_holes(mesh, size, advance)
    log.info("filled %s up to %g", say_count(filled.holes, "hole"), size)
    if filled.left:
        log.warning(
            "warning: %s up to %g left open, where the mesh is not manifold",
            say_count(filled.left, "border"), size,
        )  # fmt: skip
    return filled.mesh


def _measure_edge(mesh: Mesh) -> float:
    """Return the median length of the sides of faces."""
    places = mesh.vertices[mesh.faces]
    return float(np.median(np.linalg.norm(places - np.roll(places, 1, axis=1), axis=2)))


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
