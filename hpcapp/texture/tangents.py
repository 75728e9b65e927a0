"""The frames in which a texture's normals stand."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray, IntArray


def find_tangents(
    vertices: FloatArray, faces: IntArray, normals: FloatArray, places: FloatArray
) -> FloatArray:
    """Return the tangents of a texture, as MikkTSpace defines them.

    Parameters
    ----------
    vertices : ndarray of float64, shape (v, 3)
    faces : ndarray of int64, shape (f, 3)
    normals : ndarray of float64, shape (v, 3)
        Unit length, or zero.
    places : ndarray of float64, shape (v, 2)
        Right and down in the picture, 0 to 1.

    Returns
    -------
    ndarray of float64, shape (v, 4)
        See `Texture`.

    Notes
    -----
    The derivative of the place on the surface with respect to the first coordinate of the picture,
    turned into the plane of the vertex, weighing as the angle of the face there
    (http://www.mikktspace.com).
    """
    corners, flat = vertices[faces], places[faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    (u1, v1), (u2, v2) = (flat[:, 1] - flat[:, 0]).T, (flat[:, 2] - flat[:, 0]).T
    turns = u1 * v2 - u2 * v1  # (f,): twice the area in the picture, below zero anticlockwise
    right = (first * v2[:, None] - second * v1[:, None]) * np.sign(turns)[:, None]
    sums, hands = np.zeros_like(vertices), np.zeros(len(vertices))
    for corner in range(3):
        rows = faces[:, corner]
        around = normals[rows]
        sides = [corners[:, (corner + step) % 3] - corners[:, corner] for step in (1, 2)]
        one, other = (normalise(_flatten(side, around)) for side in sides)
        angles = np.arccos(np.clip((one * other).sum(axis=1), -1.0, 1.0))
        np.add.at(sums, rows, angles[:, None] * normalise(_flatten(right, around)))
        np.add.at(hands, rows, turns)
    tangents = normalise(sums)
    lost = ~tangents.any(axis=1)
    tangents[lost] = normalise(_flatten(_across(normals[lost]), normals[lost]))
    return np.column_stack([tangents, np.where(hands > 0.0, -1.0, 1.0)])


def _flatten(vectors: FloatArray, normals: FloatArray) -> FloatArray:
    """Return vectors without what they have along the normals."""
    flat: FloatArray = vectors - (vectors * normals).sum(axis=1, keepdims=True) * normals
    return flat


def normalise(vectors: FloatArray) -> FloatArray:
    """Return vectors of length one, and zero where they have none."""
    lengths = np.sqrt((vectors * vectors).sum(axis=1, keepdims=True))
    units: FloatArray = np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0.0)
    return units


def _across(normals: FloatArray) -> FloatArray:
    """Return for each normal the axis that it is farthest from."""
    across: FloatArray = np.eye(3)[np.abs(normals).argmin(axis=1)]
    return across
