"""A solid of a surface that is closed, or open only where a sheet ends; in millimetres, z up.

::

    closed ───────────────────────────────────────┐
    open, seen from above ── skirts to below ──────┼─> solid ── cut where it stands ── body
    open otherwise ── a second sheet behind ──────┘

What is cut, and that it is manifold behind the cut, is the library's: Manifold
(https://github.com/elalish/manifold).
"""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, Manifold, Mesh64

from hpcapp.geometry.faces import cross_edges, unit_normals
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.mending.handles import walk_borders
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import JobError

_LOWEST = 0.1
"""Of the height: a base is looked for below."""
_LAYERS = 50  # in which it is looked for
_TOUCH = 1e-6  # of the height: the layer that touches the ground
_SAME_PLANE = 0.02
"""Of the largest eigenvalue: faces that differ by less, 16 degrees, are taken for one plane."""
_MOST_ROUNDS = 400  # of smoothing
_LONGEST = 2.0  # walls: at sharper edges than of 60 degrees a wall is thinner
_RAYS = 2000  # that look for thin walls
_SKIN = 1e-3  # of a length that is looked for: where a ray begins above the surface, which it hits


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A solid as it stands on the bed of a printer.

    Parameters
    ----------
    vertices : ndarray of float64, shape (v, 3)
        In millimetres, z up.
    faces : ndarray of int64, shape (f, 3)
    pieces : int
        How many there were behind the cut; the largest by volume stay.
    lost : float
        How much of the height was cut off.
    base : float
        Area that it stands on, in square millimetres.
    volume : float
        In cubic millimetres.
    thin : float
        Share of the surface, 0 to 1, behind which there is less than what was asked for.
    stands : bool
        Whether the centre of its mass is above its base.
    """

    vertices: FloatArray
    faces: IntArray
    pieces: int
    lost: float
    base: float
    volume: float
    thin: float
    stands: bool


def back_relief(vertices: FloatArray, faces: IntArray, least: float) -> tuple[FloatArray, IntArray]:
    """Return an open surface with skirts down to below where it is to be cut, and a floor.

    That cut is at `least` below its lowest vertex; the floor is as far below it again, so that
    nothing of it stays.
    """
    floor = vertices[:, 2].min() - 2.0 * least
    corners, sides = [vertices], [faces]
    count = len(vertices)
    for loop in walk_borders(faces)[0]:
        # (n,): below each vertex of the loop another one, and one in the middle of these.
        lower = vertices[loop]
        lower[:, 2] = floor
        corners += [lower, lower.mean(axis=0, keepdims=True)]
        below = count + np.arange(len(loop))
        count += len(loop) + 1
        middle = np.full(len(loop), count - 1)
        after, after_below = np.roll(loop, -1), np.roll(below, -1)
        sides += [
            np.stack([after, loop, below], axis=1),
            np.stack([after, below, after_below], axis=1),
            np.stack([after_below, below, middle], axis=1),
        ]
    return np.concatenate(corners), np.concatenate(sides)


def thicken(vertices: FloatArray, faces: IntArray, wall: float) -> tuple[FloatArray, IntArray]:
    """Return an open surface with a second sheet behind it, and what joins their borders."""
    units = unit_normals(vertices[faces])
    # Behind every vertex the place that lies, as nearly as can be, so far behind the planes of all
    # of the faces around it: (v, 3, 3) and (v, 3) are the equations of least squares.
    products, sums = np.zeros((len(vertices), 3, 3)), np.zeros((len(vertices), 3))
    np.add.at(products, faces.reshape(-1), np.repeat(units[:, :, None] * units[:, None], 3, axis=0))
    np.add.at(sums, faces.reshape(-1), np.repeat(units, 3, axis=0))
    inverse = np.linalg.pinv(products, rcond=_SAME_PLANE, hermitian=True)
    steps = wall * np.einsum("vij,vj->vi", inverse, sums)
    lengths = np.maximum(np.linalg.norm(steps, axis=1), 1e-300)
    steps *= np.minimum(1.0, _LONGEST * wall / lengths)[:, None]
    behind = vertices - _smooth(steps, vertices, faces, wall)
    count, sides = len(vertices), [faces, faces[:, ::-1] + len(vertices)]
    for loop in walk_borders(faces)[0]:
        after = np.roll(loop, -1)
        sides += [
            np.stack([after, loop, loop + count], axis=1),
            np.stack([after, loop + count, after + count], axis=1),
        ]
    return np.concatenate([vertices, behind]), np.concatenate(sides)


def _smooth(
    steps: FloatArray, vertices: FloatArray, faces: IntArray, distance: float
) -> FloatArray:
    """Return the steps (v, 3) of vertices as means of those about so far around them.

    Else a rough surface, of edges much shorter than a wall, would fold behind it.
    """
    from scipy.sparse import csr_matrix, diags  # scipy takes its time

    ends = np.concatenate([faces, np.roll(faces, -1, axis=1)]).reshape(2, -1)
    lengths = np.linalg.norm(vertices[ends[0]] - vertices[ends[1]], axis=1)
    rounds = min(int((distance / np.median(lengths)) ** 2), _MOST_ROUNDS)
    whole = (len(vertices), len(vertices))
    joined = csr_matrix((np.ones(ends.shape[1]), (ends[0], ends[1])), whole)
    joined = joined + joined.T + diags(np.ones(len(vertices)))
    mean = diags(1.0 / np.asarray(joined.sum(axis=1)).reshape(-1)) @ joined
    for _ in range(rounds):  # as heat spreads: as far as the root of their number
        steps = mean @ steps
    return steps


def stand(
    vertices: FloatArray,
    faces: IntArray,
    pieces: int,
    least: float,
    layer: tuple[float, float] | None = None,
) -> Body:
    """Cut a closed surface flat where it stands, and keep the largest of what is left.

    Parameters
    ----------
    pieces : int
        How many are kept, the largest by their volume.
    least : float
        How thick a wall should be, in millimetres.
    layer : tuple of float, optional
        From where to where it may be cut; by default the lowest tenth.

    Raises
    ------
    JobError
        It is not closed, or nothing is left.
    """
    mesh = Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(faces, np.uint64))
    solid = Manifold(mesh)
    if solid.is_empty():
        raise JobError(f"no solid can be made of the mesh: {solid.status()}", "report this with it")
    low = solid.bounding_box()[2]
    highest = low + _LOWEST * (solid.bounding_box()[5] - low)
    height = find_base(solid, *(layer or (low, highest)))
    parts = solid.trim_by_plane((0.0, 0.0, 1.0), height).decompose()
    parts.sort(key=lambda part: -part.volume())
    if not parts:
        raise JobError("nothing is left of the mesh above its base", "report this with it")
    body = Manifold.compose(parts[:pieces]) if pieces > 1 else parts[0]
    made = body.to_mesh64()
    corners = np.ascontiguousarray(made.vert_properties[:, :3])
    triangles = made.tri_verts.astype(np.int64)
    depth = corners[:, 2] - corners[:, 2].min()
    across = cross_edges(corners[triangles])
    on_bed = (depth[triangles] <= _TOUCH * depth.max()).all(axis=1)
    hull = CrossSection.hull_points(corners[triangles[on_bed].reshape(-1), :2]).to_polygons()
    return Body(
        corners, triangles, len(parts), height - low, -0.5 * float(across[on_bed, 2].sum()),
        body.volume(), _find_thin(body, corners[triangles], across, least),
        _is_within(hull, _find_centre(corners[triangles], across)),
    )  # fmt: skip


def find_base(solid: Manifold, low: float, high: float) -> float:
    """Return the height where a solid is cut to stand.

    It is the knee of the area of its sections in a layer: what a cut there gains in area is most
    beyond what it takes of the layer, both as shares. Of a plinth that is where it is whole, of a
    plane base the base, of a ball half of the layer.
    """
    if low == high:
        return low
    tall = high - low
    shares = np.linspace(0.0, 1.0, _LAYERS + 1)
    shares[0] = _TOUCH
    areas = np.array([solid.slice(low + share * tall).area() for share in shares])
    gain = areas / max(areas.max(), 1e-300) - shares
    # Of equal ones the highest: a tip has no area.
    best = len(gain) - 1 - int(np.argmax(gain[::-1]))
    return float(low + shares[best] * tall)


def _find_thin(body: Manifold, corners: FloatArray, across: FloatArray, least: float) -> float:
    """Return the share of the surface behind which another one is nearer than that.

    Its faces have corners (f, 3, 3), and vectors (f, 3) across them, as `cross_edges` makes them.
    """
    areas = np.linalg.norm(across, axis=1)
    sums = np.cumsum(areas)
    # (r,): faces as often as they are large, one ray each, from their middle inwards.
    chosen = np.searchsorted(sums, (np.arange(_RAYS) + 0.5) / _RAYS * sums[-1])
    middles = corners[chosen].mean(axis=1)
    inward = -across[chosen] / np.maximum(areas[chosen], 1e-300)[:, None]
    starts, ends = middles - _SKIN * least * inward, middles + least * inward
    hits = (len(body.ray_cast(tuple(a), tuple(b))) for a, b in zip(starts, ends, strict=True))
    return sum(count > 1 for count in hits) / _RAYS


def _find_centre(corners: FloatArray, across: FloatArray) -> FloatArray:
    """Return the centre of the mass, (3,), of a solid whose faces are as those of `_find_thin`."""
    away = corners - corners[0, 0]
    # (f,): six times the volume of the tetrahedron between a face and that corner of the first.
    sixfold = np.einsum("ij,ij->i", away[:, 0], across)
    middle: FloatArray = corners[0, 0] + sixfold @ away.sum(axis=1) / (4.0 * sixfold.sum())
    return middle


def _is_within(hull: list[FloatArray], place: FloatArray) -> bool:
    """Tell whether a place lies above a convex polygon that runs anticlockwise."""
    if not hull or not len(hull[0]):
        return False
    sides = np.roll(hull[0], -1, axis=0) - hull[0]
    away = place[:2] - hull[0]
    return bool((sides[:, 0] * away[:, 1] - sides[:, 1] * away[:, 0] >= 0.0).all())
