"""Edges and corners are found, and kept sharp; what is round or noisy is left to one quadric."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from directions import random_directions

from hpcapp.geometry.lattice import spread_keys, unpack_keys
from hpcapp.geometry.points import BoolArray, ByteArray, FloatArray, IntArray
from hpcapp.kernels.portable.field.features import fit_features
from hpcapp.kernels.portable.lattice.points import gather_points, sort_points
from hpcapp.kernels.types.field import PIECES

SPACING = 0.6  # of the points, in cells
NOISE = 0.03


@dataclass(frozen=True)
class Shape:
    """Points in cells, their normals, and what the joined quadrics should be."""

    positions: FloatArray
    normals: FloatArray

    def fit(self, noise: float) -> tuple[IntArray, FloatArray, BoolArray, ByteArray]:
        """Return the vertices, pieces, which have some, and joints."""
        cells, offsets, rows = sort_points(self.positions, np.zeros(3), 1.0)
        local, normals = gather_points(self.positions, self.normals, rows, np.zeros(3), 1.0)
        vertices = spread_keys(cells, 0, 1)
        given = vertices, cells, offsets, local, normals, noise**2
        pieces, joints = fit_features(*given)
        return unpack_keys(vertices), pieces.astype(np.float64), joints < 255, joints


def scatter(faces: list[tuple[FloatArray, FloatArray, FloatArray]], noise: float) -> Shape:
    """Points on parallelograms (corner, side, side), off by the noise along their normals."""
    rng = np.random.default_rng(5)
    positions, normals = [], []
    for corner, a, b in faces:
        normal = np.cross(a, b)
        count = int(np.linalg.norm(normal) / SPACING**2)
        normal /= np.linalg.norm(normal)
        u = rng.uniform(size=(count, 2))
        off = noise * rng.normal(size=(count, 1)) * normal
        positions.append(corner + u[:, :1] * a + u[:, 1:] * b + off)
        normals.append(np.tile(normal, (count, 1)))
    return Shape(np.concatenate(positions), np.concatenate(normals))


def corner_faces(sign: float) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Three faces of a cube that meet at (0.3, 0.4, 0.5); of the hole it leaves for sign -1."""
    at, x, y, z = np.array([0.3, 0.4, 0.5]), *(-6.5 * np.eye(3))
    faces = [(at, x, y), (at, y, z), (at, z, x)]
    return faces if sign > 0 else [(at, b, a) for at, a, b in faces]


def evaluate(pieces: FloatArray, joints: ByteArray, at: FloatArray) -> FloatArray:
    """The definition, at one place for each vertex."""
    x, y, z = at.T
    basis = np.stack([np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, y * z, z * x])
    a, b, c = np.einsum("vki,iv->kv", pieces, basis)
    codes = joints.astype(np.int64)
    inner = np.where(codes & 2, np.minimum(b, c), np.maximum(b, c))
    joined: FloatArray = np.where(codes & 1, np.minimum(a, inner), np.maximum(a, inner))
    return joined


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["convex", "concave"])
@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_corners_are_sharp(sign: float, noise: float) -> None:
    places, pieces, found, joints = scatter(corner_faces(sign), noise).fit(noise)
    off = np.array([0.3, 0.4, 0.5]) - places
    near = (np.abs(off).max(axis=1) < 1.0) & (np.abs(off).min(axis=1) >= 0.0)
    assert found[near].all()
    # At the corner the joined quadrics are 0, a cell along the diagonal the true distance.
    at_corner = evaluate(pieces[near], joints[near], off[near])
    assert np.abs(at_corner).max() < 0.02 + 3.0 * noise
    for step in (0.5, -0.5):
        distance = evaluate(pieces[near], joints[near], off[near] + step)
        np.testing.assert_allclose(distance, step if sign > 0 else -step, atol=0.05 + 4.0 * noise)


def test_edges_are_where_faces_meet() -> None:
    """Along the three edges of a corner, far from it, two pieces are joined."""
    places, pieces, found, joints = scatter(corner_faces(1.0), NOISE).fit(NOISE)
    edge = np.array([0.3, 0.4, 0.0])
    off = edge - places
    off[:, 2] = 0.0
    along = (np.abs(off).max(axis=1) < 1.0) & (places[:, 2] < -2) & (places[:, 2] > -5)
    assert along.sum() > 4
    assert found[along].all()
    assert np.abs(evaluate(pieces[along], joints[along], off[along])).max() < 0.12
    assert pieces.shape[1] == PIECES


def test_flat_and_round_is_left_alone() -> None:
    rng = np.random.default_rng(3)
    normals = random_directions(4000, rng)
    for radius in (4.0, 7.0):
        kept = normals[: int(4.0 * np.pi * radius**2 / SPACING**2)]
        positions = (radius + NOISE * rng.normal(size=(len(kept), 1))) * kept
        ball = Shape(positions, kept)
        assert not ball.fit(NOISE)[2].any()
    flat = scatter([(np.zeros(3), np.array([9.0, 0, 1]), np.array([0, 9.0, 2]))], NOISE)
    assert not flat.fit(NOISE)[2].any()


def test_noise_makes_no_edges() -> None:
    """Positions and normals of a plane that are off by a good deal."""
    flat = scatter([(np.zeros(3), np.array([9.0, 0, 1]), np.array([0, 9.0, 2]))], 0.2)
    rng = np.random.default_rng(4)
    rough = flat.normals + 0.3 * rng.normal(size=flat.normals.shape)
    rough /= np.linalg.norm(rough, axis=1, keepdims=True)
    assert Shape(flat.positions, rough).fit(0.2)[2].mean() < 0.01
