"""The line that says what a mesh is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hpcapp.applications.surface.steps.summary import summarize
from hpcapp.applications.surface.stitching.topology import Topology, check_mesh
from hpcapp.geometry.mesh import Mesh

CORNERS = np.array([[0.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


@pytest.fixture
def closed() -> Topology:
    return check_mesh(Mesh(CORNERS, FACES))


def test_a_closed_mesh(closed: Topology) -> None:
    assert summarize(closed, {}) == "4 vertices, 4 faces, watertight, 1 piece"
    large = replace(closed, vertices=1_204_000, components=3)
    assert summarize(large, {}) == "1,204,000 vertices, 4 faces, watertight, 3 pieces"


def test_an_open_mesh() -> None:
    summary = summarize(check_mesh(Mesh(CORNERS, FACES[1:])), {})
    assert summary == "4 vertices, 3 faces, open, 1 boundary, 1 piece"


def test_what_no_point_supports(closed: Topology) -> None:
    facts = {"spacing": 0.02, "support": {"share": 0.98349, "farthest": 0.26, "reach": 0.06}}
    assert summarize(closed, facts).endswith(
        "1 piece; 98.3 % supported by points; the rest is up to 13 spacings away"
    )
    facts["support"] = {"share": 1.0, "farthest": 0.0, "reach": 0.06}
    assert summarize(closed, facts).endswith("1 piece; 100 % supported by points")
