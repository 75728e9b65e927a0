from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hpcapp.applications.surface.paper.indicator_blend import NodeGrid
from hpcapp.applications.surface.paper.iso_surface import extract_iso_surface
from hpcapp.applications.surface.stitching.topology import check_mesh, signed_volume
from hpccomponent.errors import JobError

NODES = NodeGrid(np.array([-1.3, -1.25, 4.0]), 0.05, (53, 52, 54))
CENTER, RADIUS = np.array([0.0, 0.0, 5.3]), 1.0


def sphere() -> NDArray[np.float32]:
    x = NODES.low + NODES.step * np.stack(list(np.indices(NODES.shape)), axis=-1)
    values: NDArray[np.float32] = (np.linalg.norm(x - CENTER, axis=-1) - RADIUS).astype(np.float32)
    return values


def test_sphere_is_where_it_should_be_and_looks_outward() -> None:
    mesh = extract_iso_surface(sphere(), NODES, np.array([1e6, 0.0, 0.0]))
    radii = np.linalg.norm(mesh.vertices - CENTER, axis=1)
    assert np.abs(radii - RADIUS).max() < 0.02 * NODES.step
    # A polyhedron with its corners on the sphere is smaller than the ball, by little.
    ball = 4.0 / 3.0 * np.pi * RADIUS**3
    assert 0.99 * ball < signed_volume(mesh) < ball
    assert mesh.origin.tolist() == [1e6, 0.0, 0.0]


def test_sphere_is_watertight_and_in_one_piece() -> None:
    topology = check_mesh(extract_iso_surface(sphere(), NODES))
    assert topology.watertight
    assert topology.components == 1
    assert topology.genus == 0


@pytest.mark.parametrize("value", [1.0, -1.0, 0.0])
def test_one_sign_only_is_an_empty_surface(value: float) -> None:
    with pytest.raises(JobError, match="the surface is empty; use a finer grid"):
        extract_iso_surface(np.full(NODES.shape, value, np.float32), NODES)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_are_not_meshed_silently(value: float) -> None:
    values = sphere()
    values[3, 4, 5] = value
    with pytest.raises(JobError, match="not finite"):
        extract_iso_surface(values, NODES)
