"""A virtual range scanner: analytic shapes seen as scanners see them, faults included.

::

    views on a sphere -> rays -> first hit -> what is lost -> depth noise -> poses
                                                                               |
                   flipped normals <- normals (PCA or exact) <- outliers <- all views

Fractions of length are fractions of the shape's bounding-box diagonal. One seed gives one scan.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from hpcapp.applications.simulate.rays import cross_rays, frame_about, sample_lines, unit_vectors
from hpcapp.applications.simulate.settings import ScanSettings
from hpcapp.applications.simulate.shapes import Shape, diagonal_of
from hpccomponent.errors import UsageError
from hpccomponent.surface.types.points import FloatArray, IntArray, PointCloud

__all__ = ["ScanSettings", "sample_surface", "simulate_scan"]

_NEIGHBOURS = 20
_GOLDEN_TURN = np.pi * (3.0 - np.sqrt(5.0))
_MOST_RAYS = 1_000_000  # at a time: bounds the memory
_LEAST_YIELD = 0.002  # points by ray: below it a scan would take for ever


@dataclass(frozen=True, slots=True, eq=False)
class _Hits:
    """Points of the surface as they were met: exact position, normal, ray and view of each."""

    positions: FloatArray
    normals: FloatArray
    rays: FloatArray
    view: IntArray

    def take(self, selection: NDArray[np.bool_] | IntArray) -> _Hits:
        return _Hits(*(getattr(self, f.name)[selection] for f in fields(self)))


def simulate_scan(shape: Shape, settings: ScanSettings | None = None) -> PointCloud:
    """Scan an analytic shape.

    Parameters
    ----------
        shape : Shape
            See `hpcapp.applications.simulate.shapes.SHAPES`.
        settings : ScanSettings, optional

    Returns
    -------
        PointCloud
            Exactly ``settings.points`` points with unit normals, view by view.

    Raises
    ------
        UsageError
            If hardly any ray comes back.

    Examples
    --------
        >>> from hpcapp.applications.simulate.shapes import SHAPES
        >>> cloud = simulate_scan(SHAPES["torus"], ScanSettings(points=500, noise=0.001))
        >>> len(cloud)
        500
    """
    settings = settings or ScanSettings()
    rng = np.random.default_rng(settings.seed)
    diagonal = diagonal_of(shape)
    look = _look(shape, settings, rng)
    hits = _gather(shape, settings, rng, look)
    depth = settings.noise * diagonal * rng.standard_normal(len(hits.view))
    positions = hits.positions + depth[:, None] * hits.rays
    positions, exact = _misplace(shape, settings, rng, positions, hits)
    positions, is_outlier = _strew(shape, settings, rng, positions, hits.rays)
    facing = exact if settings.views == 0 else -hits.rays
    normals = exact if settings.normals == "exact" else _fit_normals(positions, facing)
    normals = np.where(
        (is_outlier & (settings.normals == "exact"))[:, None],
        unit_vectors(rng.standard_normal(normals.shape)),
        normals,
    )
    wrong = rng.permutation(len(normals))[: round(settings.flipped * len(normals))]
    normals[wrong] *= -1.0
    return PointCloud(positions, normals)


def sample_surface(shape: Shape, count: int, seed: int = 0) -> PointCloud:
    """Return exact points and normals, spread evenly over the whole surface.

    Parameters
    ----------
    shape : Shape
    count : int
        Exactly as many points.
    seed : int

    Returns
    -------
    PointCloud
        Off the surface by less than 1e-12 of the diagonal.
    """
    rng = np.random.default_rng(seed)
    found = [np.empty((0, 3))]
    lines, have = 2 * count, 0
    while have < count:
        found.append(sample_lines(shape, lines, rng))
        have += len(found[-1])
        lines = int(1.2 * lines * (count - have) / max(len(found[-1]), 1)) + 100
    points = np.concatenate(found)
    chosen = points[rng.permutation(len(points))[:count]]
    return PointCloud(chosen, shape.normal(chosen))


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """What stays the same from one round of rays to the next.

    Eyes and their frames, one per view; the waves that shape each view's blotches; the
    direction in which the density falls; the middles of the regions that do not echo.
    """

    eyes: FloatArray
    waves: FloatArray
    thresholds: FloatArray
    slope: FloatArray
    holes: FloatArray


def _look(shape: Shape, settings: ScanSettings, rng: np.random.Generator) -> _Look:
    """Place the scanner and decide what it will not see."""
    low, high = shape.bounds
    rank = np.arange(settings.views) + 0.5
    height = 1.0 - 2.0 * rank / max(settings.views, 1)
    ring, turn = np.sqrt(1.0 - height**2), _GOLDEN_TURN * rank
    sphere = np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1)
    spin = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    eyes = 0.5 * (low + high) + diagonal_of(shape) * sphere @ spin.T
    waves = rng.uniform(-9.0, 9.0, (settings.views, 6, 3))
    probe = _disc(np.arange(4096), np.zeros(2))
    levels = [np.quantile(_ripple(probe, wave[None]), 1.0 - settings.dropout) for wave in waves]
    slope = unit_vectors(rng.standard_normal((1, 3)))[0]
    holes = sample_surface(shape, settings.missing, int(rng.integers(2**31))).positions
    return _Look(eyes, waves, np.array(levels), slope, holes)


def _gather(shape: Shape, settings: ScanSettings, rng: np.random.Generator, look: _Look) -> _Hits:
    """Shoot rays in rounds until enough of them have come back, then keep as many as wanted."""
    want, cast, have = settings.points, 0, 0
    rounds: list[_Hits] = []
    batch = min(max(2 * want, 1000), _MOST_RAYS)
    while have < want and have >= _LEAST_YIELD * cast:
        hits = _meet(shape, settings, rng, look, cast, batch)
        rounds.append(hits)
        cast, have = cast + batch, have + len(hits.view)
        batch = int(np.clip(1.1 * (want - have) * cast / max(have, 1), 1000, _MOST_RAYS))
    if have < want:
        raise UsageError(
            f"only {have} of {cast} rays at the {shape.name} came back, {want} are wanted",
            "ask for fewer points, less dropout or a larger grazing angle",
        )
    every = _Hits(*(np.concatenate([getattr(h, f.name) for h in rounds]) for f in fields(_Hits)))
    chosen = rng.permutation(have)[:want]
    return every.take(chosen[np.lexsort((chosen, every.view[chosen]))])


def _meet(
    shape: Shape,
    settings: ScanSettings,
    rng: np.random.Generator,
    look: _Look,
    cast: int,
    batch: int,
) -> _Hits:
    """Return what one round of rays meets and does not lose."""
    if settings.views == 0:
        points = sample_lines(shape, batch, rng)
        normals = shape.normal(points)
        hits = _Hits(points, normals, normals, np.zeros(len(points), dtype=np.int64))
    else:
        hits = _shoot(shape, settings, rng, look, np.arange(cast, cast + batch))
    keep = np.ones(len(hits.view), dtype=bool)
    if settings.density_ratio > 1.0:
        low, high = shape.bounds
        reach = 0.5 * np.abs(look.slope) @ (high - low)
        along = 0.5 + 0.5 * ((hits.positions - 0.5 * (low + high)) @ look.slope) / reach
        keep &= rng.random(len(keep)) < settings.density_ratio**-along
    for hole in look.holes:
        away = np.linalg.norm(hits.positions - hole, axis=1)
        keep &= away > 0.05 * diagonal_of(shape)
    return hits.take(keep)


def _shoot(
    shape: Shape, settings: ScanSettings, rng: np.random.Generator, look: _Look, number: IntArray
) -> _Hits:
    """Cast the rays of these numbers and drop those that graze or fall into a blotch."""
    low, high = shape.bounds
    diagonal = diagonal_of(shape)
    view = number % settings.views
    eye = look.eyes[view]
    # The disc at the shape's middle that just covers the bounding sphere, seen from one diagonal.
    spot = _disc(number // settings.views, rng.random(2))
    axis = unit_vectors(0.5 * (low + high) - eye)
    side, up = frame_about(axis)
    radius = diagonal * np.tan(np.arcsin(0.5))
    aim = diagonal * axis + radius * (spot[:, :1] * side + spot[:, 1:] * up)
    rays = unit_vectors(aim)
    if settings.dropout:
        seen = _ripple(spot, look.waves[view]) <= look.thresholds[view]
        eye, rays, view = eye[seen], rays[seen], view[seen]
    met, distance = cross_rays(shape, eye, rays, 1.6 * diagonal, first_only=True)
    positions, rays = eye[met] + distance[:, None] * rays[met], rays[met]
    normals = shape.normal(positions)
    facing = -np.einsum("ij,ij->i", normals, rays)
    echoes = facing > np.cos(np.radians(settings.grazing))
    return _Hits(positions, normals, rays, view[met]).take(echoes)


def _disc(number: IntArray, shift: FloatArray) -> FloatArray:
    """Return points of the unit disc, shape (n, 2), evenly spread for any run of numbers.

    Notes
    -----
    The additive recurrence of the plastic number (M. Roberts, 2018, sequence R2).
    """
    plastic = 1.32471795724474602596
    square = (shift + np.outer(number + 1, [1 / plastic, 1 / plastic**2])) % 1.0
    radius, angle = np.sqrt(square[:, 0]), 2 * np.pi * square[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def _ripple(spot: FloatArray, waves: FloatArray) -> FloatArray:
    """Return the sum of six plane waves at each spot of a view's image."""
    phase = np.einsum("ij,ikj->ik", spot, np.broadcast_to(waves, (len(spot), 6, 3))[:, :, :2])
    height: FloatArray = np.cos(phase + waves[..., 2]).sum(axis=1)
    return height


def _misplace(
    shape: Shape,
    settings: ScanSettings,
    rng: np.random.Generator,
    positions: FloatArray,
    hits: _Hits,
) -> tuple[FloatArray, FloatArray]:
    """Register each view wrongly: a small rotation about the middle and a small shift."""
    if not settings.pose_error:
        return positions, hits.normals
    low, high = shape.bounds
    middle = 0.5 * (low + high)
    shift = settings.pose_error * diagonal_of(shape) * rng.standard_normal((settings.views, 3))
    # The ends are half a diagonal away: there a turn by 2 e moves as far as a shift by e.
    turn = 2.0 * settings.pose_error * rng.standard_normal((settings.views, 3))[hits.view]
    local = positions - middle
    # A Cayley rotation is exact: no angle is too large for it.
    moved = middle + _rotate(local, turn) + shift[hits.view]
    return moved, _rotate(hits.normals, turn)


def _rotate(vectors: FloatArray, turn: FloatArray) -> FloatArray:
    """Rotate each vector about its `turn`, whose length is twice the tangent of half the angle."""
    half = 0.5 * turn
    first = np.cross(half, vectors)
    scale = 2.0 / (1.0 + np.einsum("ij,ij->i", half, half))
    rotated: FloatArray = vectors + scale[:, None] * (first + np.cross(half, first))
    return rotated


def _strew(
    shape: Shape,
    settings: ScanSettings,
    rng: np.random.Generator,
    positions: FloatArray,
    rays: FloatArray,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Replace some points by outliers; tell which."""
    low, high = shape.bounds
    chosen = rng.permutation(len(positions))[: round(settings.outliers * len(positions))]
    near, far = np.array_split(chosen, 2)
    offset = (
        diagonal_of(shape) * rng.uniform(0.02, 0.10, len(near)) * rng.choice([-1, 1], len(near))
    )
    strewn = positions.copy()
    strewn[near] += offset[:, None] * rays[near]
    strewn[far] = 0.5 * (low + high) + (high - low) * rng.uniform(-1.0, 1.0, (len(far), 3))
    is_outlier = np.zeros(len(positions), dtype=bool)
    is_outlier[chosen] = True
    return strewn, is_outlier


def _fit_normals(positions: FloatArray, facing: FloatArray) -> FloatArray:
    """Return the normals of the planes through the nearest neighbours, turned to `facing`."""
    neighbours = min(_NEIGHBOURS, len(positions))
    tree = KDTree(positions)
    normals = np.empty_like(positions)
    for start in range(0, len(positions), 50_000):
        part = slice(start, start + 50_000)
        nearest = tree.query(positions[part], k=neighbours)[1].reshape(-1, neighbours)
        around = positions[nearest]
        around -= around.mean(axis=1, keepdims=True)
        spread = np.einsum("nki,nkj->nij", around, around)
        normals[part] = np.linalg.eigh(spread)[1][:, :, 0]
    normals[np.einsum("ij,ij->i", normals, facing) < 0.0] *= -1.0
    return normals
