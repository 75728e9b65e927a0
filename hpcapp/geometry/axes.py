"""Which axis points up, and how what is upright there is turned to be upright elsewhere."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.points import FloatArray

_TO_Z: dict[str, list[list[int]]] = {
    "z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "x": [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    "-z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "-y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "-x": [[0, -1, 0], [0, 0, 1], [-1, 0, 0]],
}


def turn_up(axis: str, to: str = "z") -> FloatArray:
    """Return the rotation (3, 3) that makes one of `axis_names.AXES` point where another one does.

    Examples
    --------
    >>> (turn_up("y") @ (0.0, 1.0, 0.0)).tolist()
    [0.0, 0.0, 1.0]
    >>> (turn_up("z", to="y") @ (1.0, 2.0, 3.0)).tolist()
    [1.0, 3.0, -2.0]
    """
    turn: FloatArray = np.array(_TO_Z[to], float).T @ np.array(_TO_Z[axis], float)
    return turn + 0.0  # no negative zeros


def rotate(places: FloatArray, axes: FloatArray | None) -> FloatArray:
    """Return a place, or n, shape (n, 3), along the rows of a matrix; as they are without one.

    Each is what it would be alone, bit for bit: a product of matrices has no such promise.
    """
    if axes is None:
        return places
    x, y, z = places.T
    return np.stack([x * row[0] + y * row[1] + z * row[2] for row in axes], axis=-1)


def turn_by(quaternions: FloatArray) -> FloatArray:
    """Return the rotations, of shape (..., 3, 3), of unit quaternions w, x, y, z, (..., 4).

    Examples
    --------
    >>> turn_by(np.array([0.0, 0.0, 0.0, 1.0])).tolist()
    [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return np.stack(rows, axis=-1).reshape(*quaternions.shape[:-1], 3, 3)


# What an object stands on, by 19 meshes of the tuning scans and the bunny, in shares of the area
# that its box covers. Of the seven that stand on y it is .07 (dancing_children) to .28 (falcon),
# and another side has .39 of that at most (falcon). Of those that do not, it is .03 at most where y
# leads (scorpion), or another side has more than half of it (walls of a town) or as much (gear).
_LEAST_BASE = 0.045
_MOST_OF_OTHERS = 0.45

_LAYER = 0.02  # of the height: what touches the ground
_FLAT = 0.9  # cosine: the base looks down
# Sum of the area vectors in shares of the area, zero of a closed surface: .017 of the bunny with
# its holes, .27 of a room without a ceiling, .5 to .9 of facades, corners and terrain.
_MOST_OPEN = 0.06

_SHELL = 0.05  # of a side of the box: where the walls of a room stand, and what hangs on them
# Of a side of the box: what looks inwards there. Of ten scanned rooms walls and floors cover .73 or
# more, where doors, windows and furniture take their share; a ceiling that was not scanned 0 to .1.
_LEAST_WALL = 0.45
_MOST_CEILING = 0.2


def measure_faces(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the middles of triangles, of shape (f, 3, 3), and their normals as long as areas."""
    return corners.mean(axis=1), 0.5 * cross_edges(corners)


def find_up(faces: Iterator[tuple[FloatArray, FloatArray]], box: FloatArray) -> str:
    """Return the axis that points up: y where a surface stands on a flat base there, else z.

    Of open ones y is up in a room with four walls and a floor whose ceiling is open, as phones scan
    it, if it is lower there than it is wide; others tell nothing: the wall of a house lies as flat
    as the base of a statue. Faces come as their middles and their normals as long as their areas,
    (f, 3) each, with the box (2, 3) around.
    """
    sides = box[1] - box[0]
    total, whole, bases, shell = 0.0, np.zeros(3), np.zeros((2, 3)), np.zeros((2, 3))
    for middles, vectors in faces:
        areas = np.linalg.norm(vectors, axis=1)
        total += float(areas.sum())
        whole += vectors.sum(axis=0)
        for side, (depths, facing) in enumerate(
            ((middles - box[0], -vectors), (box[1] - middles, vectors))
        ):
            is_base = (depths < _LAYER * sides) & (facing > _FLAT * areas[:, None])
            bases[side] += np.where(is_base, facing, 0.0).sum(axis=0)
            is_shell = (depths < _SHELL * sides) & (facing < -_FLAT * areas[:, None])
            shell[side] -= np.where(is_shell, facing, 0.0).sum(axis=0)
    if not sides.all():
        return "z"
    if np.linalg.norm(whole) > _MOST_OPEN * total:
        return "y" if _is_room(shell / (sides.prod() / sides), sides) else "z"
    shares = bases / (sides.prod() / sides)
    base, shares[0, 1] = float(shares[0, 1]), 0.0
    return "y" if base > _LEAST_BASE and shares.max() < _MOST_OF_OTHERS * base else "z"


def _is_room(shell: FloatArray, sides: FloatArray) -> bool:
    """Tell whether a room is open at the upper end of y alone, and lowest along y.

    The shell (2, 3) is the share of each side of its box, low and high, that looks inwards.
    """
    ceiling, walls = float(shell[1, 1]), np.delete(shell.ravel(), 4)
    return bool(walls.min() > _LEAST_WALL and ceiling < _MOST_CEILING and np.argmin(sides) == 1)
