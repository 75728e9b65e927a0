"""Directions at random, evenly all around: points of a unit sphere, and their normals."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray


def random_directions(count: int, seed: int | np.random.Generator) -> FloatArray:
    """Return so many unit vectors, (n, 3)."""
    arms = np.random.default_rng(seed).normal(size=(count, 3))
    directions: FloatArray = arms / np.linalg.norm(arms, axis=1, keepdims=True)
    return directions
