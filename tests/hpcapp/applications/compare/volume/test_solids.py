"""Closed meshes whose difference is known."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.measure import marching_cubes

import hpcapp
from hpcapp.applications.compare.volume.measure import Volume
from hpccomponent.errors import InputError

CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
])  # fmt: skip
FAR = np.array([4e5, 5e6, 0.0])


def block(*sides: float, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> hpcapp.Mesh:
    return hpcapp.Mesh(CORNERS * sides + at + FAR, FACES)


def ball(radius: float) -> hpcapp.Mesh:
    axis = np.linspace(-1.3, 1.3, 50)
    value = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1), axis=-1)
    # scikit-image has no types
    vertices, faces, _, _ = marching_cubes(value, 1.0)  # type: ignore[no-untyped-call]
    vertices -= vertices.mean(axis=0)
    return hpcapp.Mesh(radius * vertices / np.linalg.norm(vertices, axis=1)[:, None], faces)


def near(part: Volume, volume: float) -> bool:
    return abs(part.volume - volume) <= 1.01 * part.uncertainty + 1e-9  # samples are 50,000


def test_what_only_one_of_them_encloses_is_cut_or_filled() -> None:
    higher = hpcapp.compare_epochs(block(1.0, 1.0, 1.1), block(1.0, 1.0, 1.0))
    assert higher.kind == "closed"
    assert higher.net.volume == pytest.approx(0.1)
    assert near(higher.fill, 0.1)
    assert near(higher.cut, 0.0)
    assert higher.fill.area == pytest.approx(1.4, abs=0.05)  # the top, and the sides below it
    assert max(higher.fill.uncertainty, higher.cut.uncertainty) < 0.01
    lower = hpcapp.compare_epochs(block(1.0, 1.0, 1.0), block(1.0, 1.0, 1.1))
    assert near(lower.cut, 0.1)
    assert lower.net.volume == pytest.approx(-0.1)
    assert lower.only_new == lower.only_old == 0.0


def test_faces_may_look_inwards() -> None:
    inward = hpcapp.Mesh(block(1.0, 1.0, 1.1).vertices, FACES[:, ::-1])
    change = hpcapp.compare_epochs(inward, block(1.0, 1.0, 1.0))
    assert change.net.volume == pytest.approx(0.1)
    assert near(change.fill, 0.1)


def test_a_shift_is_found_and_is_uncertain() -> None:
    old = block(1.0, 1.0, 1.0)
    moved = hpcapp.compare_epochs(block(1.0, 1.0, 1.0, at=(0.02, -0.01, 0.03)), old)
    assert moved.shift == pytest.approx((0.02, -0.01, 0.03), abs=2e-3)
    assert moved.net.volume == pytest.approx(0.0, abs=1e-9)
    assert near(moved.cut, 0.0)
    assert near(moved.fill, 0.0)


def test_swelling_all_over_is_uncertain_unless_the_user_vouches() -> None:
    old, new = ball(1.0), ball(1.05)
    swelling = 4.0 / 3.0 * np.pi * (1.05**3 - 1.0)
    doubted = hpcapp.compare_epochs(new, old)
    assert doubted.offset == pytest.approx(0.05, abs=0.002)
    assert near(doubted.fill, 0.0)
    assert near(doubted.net, 0.0)
    sure = hpcapp.compare_epochs(new, old, registration=0.0)
    assert sure.net.volume == pytest.approx(swelling, rel=0.01)
    assert sure.fill.volume == pytest.approx(swelling, rel=0.01)
    assert sure.fill.uncertainty < 0.01 * swelling


def test_only_one_that_is_closed_is_refused() -> None:
    solid = block(1.0, 1.0, 1.0)
    for other in (hpcapp.Mesh(solid.vertices, FACES[2:]), np.random.default_rng(0).random((99, 3))):
        for epochs in ((solid, other), (other, solid)):
            with pytest.raises(InputError, match="is a closed mesh and"):
                hpcapp.compare_epochs(*epochs)
