"""A virtual range scanner: analytic shapes seen as scanners see them, faults included.

::

    views on a sphere -> rays -> first hit -> what is lost -> depth noise, drift -> poses
                                                                                      |
                          flipped normals <- normals (PCA or exact) <- outliers <- all views

Fractions of length are fractions of the shape's bounding-box diagonal. One seed gives one scan.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpcapp.lab.simulate.faults import draw_drift, draw_moves, strew_outliers
from hpcapp.lab.simulate.implicit import Solid, diagonal_of
from hpcapp.lab.simulate.rays import (
    frame_about,
    run_in_blocks,
    sample_lines,
    unit_vectors,
)
from hpcapp.lab.simulate.settings import ScanSettings
from hpcapp.lab.simulate.tracing import Tracer
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError

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

    @staticmethod
    def join(parts: list[_Hits]) -> _Hits:
        names = [f.name for f in fields(_Hits)]
        return _Hits(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def simulate_scan(shape: Solid, settings: ScanSettings | None = None) -> PointCloud:
    """Scan an analytic shape: exactly ``settings.points`` with unit normals, view by view.

    Raise UsageError where hardly any ray comes back.

    Examples
    --------
    >>> from hpcapp.lab.simulate.shapes import SHAPES
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
    if settings.drift:
        length = settings.correlation * diagonal
        depth += settings.drift * diagonal * draw_drift(hits.positions, hits.view, length, rng)
    positions, exact = hits.positions + depth[:, None] * hits.rays, hits.normals
    if settings.pose_error:
        moves = draw_moves(settings.views, settings.pose_error * diagonal, diagonal, rng)
        middle = 0.5 * np.sum(shape.bounds, axis=0)
        positions, exact = moves.apply(positions, exact, hits.view, middle)
    positions, is_outlier = strew_outliers(shape, settings.outliers, positions, hits.rays, rng)
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


def sample_surface(shape: Solid, count: int, seed: int = 0) -> PointCloud:
    """Return exactly `count` points of the surface with their normals, spread evenly.

    They are off the surface by less than 1e-12 of the diagonal.
    """
    rng = np.random.default_rng(seed)
    crossings = [np.empty((0, 3))]
    lines, count_so_far, tracer = 2 * count, 0, Tracer(shape, 2 * count)
    while count_so_far < count:
        crossings.append(sample_lines(shape, lines, rng, tracer))
        count_so_far += len(crossings[-1])
        lines = int(1.2 * lines * (count - count_so_far) / max(len(crossings[-1]), 1)) + 100
    points = np.concatenate(crossings)
    chosen = points[rng.permutation(len(points))[:count]]
    normals = run_in_blocks(lambda part: shape.normal(chosen[part]), count)
    return PointCloud(chosen, np.concatenate(normals))


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """What stays the same from one round of rays to the next.

    Eyes and their frames (ahead, aside, up: shape (3, views, 3)); the waves that shape each
    view's blotches; the direction in which the density falls; the middles of the regions that do
    not echo; what traces the rays.
    """

    eyes: FloatArray
    frames: FloatArray
    waves: FloatArray
    thresholds: FloatArray
    slope: FloatArray
    holes: FloatArray
    tracer: Tracer


def _look(shape: Solid, settings: ScanSettings, rng: np.random.Generator) -> _Look:
    """Place the scanner and decide what it will not see."""
    low, high = shape.bounds
    # (v,): views in a golden spiral on the unit sphere; (v, 3): eyes, turned by chance
    rank = np.arange(settings.views) + 0.5
    height = 1.0 - 2.0 * rank / max(settings.views, 1)
    ring, turn = np.sqrt(1.0 - height**2), _GOLDEN_TURN * rank
    sphere = np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1)
    spin = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    eyes = 0.5 * (low + high) + diagonal_of(shape) * sphere @ spin.T
    ahead = unit_vectors(0.5 * (low + high) - eyes)
    # (3, v, 3): ahead, side and up of each view
    frames = np.stack([ahead, *frame_about(ahead)])
    waves = rng.uniform(-9.0, 9.0, (settings.views, 6, 3))
    probe = _disc(np.arange(4096), np.zeros(2))
    levels = [np.quantile(_ripple(probe, wave[None]), 1.0 - settings.dropout) for wave in waves]
    slope = unit_vectors(rng.standard_normal((1, 3)))[0]
    holes = sample_surface(shape, settings.missing, int(rng.integers(2**31))).positions
    return _Look(
        eyes, frames, waves, np.array(levels), slope, holes, Tracer(shape, 2 * settings.points)
    )


def _gather(shape: Solid, settings: ScanSettings, rng: np.random.Generator, look: _Look) -> _Hits:
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
    every = _Hits.join(rounds)
    chosen = rng.permutation(have)[:want]
    return every.take(chosen[np.lexsort((chosen, every.view[chosen]))])


def _meet(
    shape: Solid,
    settings: ScanSettings,
    rng: np.random.Generator,
    look: _Look,
    cast: int,
    batch: int,
) -> _Hits:
    """Return what one round of rays meets and does not lose."""
    if settings.views == 0:
        points = sample_lines(shape, batch, rng, look.tracer)
        parts = run_in_blocks(lambda part: shape.normal(points[part]), len(points))
        normals = np.concatenate(parts)
        hits = _Hits(points, normals, normals, np.zeros(len(points), dtype=np.int64))
    else:
        hits = _shoot(shape, settings, look, cast, batch, rng.random(2))
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
    shape: Solid,
    settings: ScanSettings,
    look: _Look,
    first: int,
    count: int,
    shift: FloatArray,
) -> _Hits:
    """Cast `count` rays and drop those that graze or fall into a blotch."""
    diagonal = diagonal_of(shape)
    radius = diagonal * np.tan(np.arcsin(0.5))

    def shoot(part: slice) -> _Hits:
        # (b,): the rays of this block, dealt to the views in turn
        number = np.arange(first + part.start, first + part.stop)
        view = number % settings.views
        # The disc at the shape's middle that just covers the bounding sphere, from one diagonal.
        # (b, 2): where in its view's image a ray points
        spot = _disc(number // settings.views, shift)
        if settings.dropout:
            seen = _ripple(spot, look.waves[view]) <= look.thresholds[view]
            spot, view = spot[seen], view[seen]
        ahead, side, up = look.frames
        aim = spot[:, :1] * side[view] + spot[:, 1:] * up[view]
        # (b, 3): unit directions
        rays = unit_vectors(diagonal * ahead[view] + radius * aim)
        eye = look.eyes[view]
        met, distance = look.tracer.cross(eye, rays, 1.6 * diagonal, first_only=True)
        # (h, 3) from here: those that met the surface, where they did, and its normals
        rays = rays[met]
        positions = eye[met] + distance[:, None] * rays
        normals = shape.normal(positions)
        echoes = -np.einsum("ij,ij->i", normals, rays) > np.cos(np.radians(settings.grazing))
        return _Hits(positions, normals, rays, view[met]).take(echoes)

    return _Hits.join(run_in_blocks(shoot, count))


def _disc(number: IntArray, shift: FloatArray) -> FloatArray:
    """Return points of the unit disc, shape (n, 2), evenly spread for any run of numbers.

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


def _fit_normals(positions: FloatArray, facing: FloatArray) -> FloatArray:
    """Return the normals of the planes through the nearest neighbours, turned to `facing`."""
    neighbours = min(_NEIGHBOURS, len(positions))
    tree = KDTree(positions)
    normals = np.empty_like(positions)

    def fit(part: slice) -> None:
        # In the order of the tree, so that one query finds in the cache what the last one read.
        rows = tree.indices[part]
        nearest = tree.query(positions[rows], k=neighbours)[1].reshape(-1, neighbours)
        # (b, k, 3): each point's neighbours about their mean; (b, 3, 3): their spread
        around = positions[nearest]
        around -= around.mean(axis=1, keepdims=True)
        spread = around.transpose(0, 2, 1) @ around
        normals[rows] = np.linalg.eigh(spread)[1][:, :, 0]

    run_in_blocks(fit, len(positions))
    normals[np.einsum("ij,ij->i", normals, facing) < 0.0] *= -1.0
    return normals
