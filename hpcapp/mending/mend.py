"""A mesh that is there, mended: its holes filled, then its pieces chosen."""

from __future__ import annotations

import logging

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.pieces import PieceChoice, find_small, say_dropped, say_small
from hpcapp.mending.holes import fill_holes
from hpcapp.mending.pieces import keep_faces, measure_pieces
from hpcapp.wording import say_count

log = logging.getLogger("hpcapp")


def mend_mesh(mesh: Mesh, size: float | None, choice: PieceChoice) -> Mesh:
    """Fill holes of a mesh, and drop pieces of it.

    Parameters
    ----------
    mesh : Mesh
        With a face.
    size : float or None
        Holes up to it are filled: the diagonal of the box around a border, in units of the mesh.
    choice : PieceChoice
        Where nothing is chosen, small pieces are named.

    Raises
    ------
    UsageError
        No piece is as large as was asked for.
    """
    if size is not None:
        filled = fill_holes(mesh, size)
        mesh = filled.mesh
        log.info("filled %s", say_count(filled.holes, "hole"))
        if filled.left:
            log.warning(
                "warning: %s up to %g left open, where the mesh is not manifold",
                say_count(filled.left, "border"), size,
            )  # fmt: skip
    pieces, areas = measure_pieces(mesh)
    if not choice.is_something:
        is_small = find_small(areas)
        if is_small.any():
            log.info("%s", say_small(areas, is_small))
        return mesh
    stays = choice.choose(areas)
    log.info("%s", say_dropped(areas, stays))
    return keep_faces(mesh, stays[pieces])
