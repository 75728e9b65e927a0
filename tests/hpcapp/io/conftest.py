"""Files made on the spot: PLY text and bytes, small clouds and meshes with known truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud

MakeFile = Callable[..., Path]


@pytest.fixture
def make_file(tmp_path: Path) -> MakeFile:
    """Write a file of the given name and content (text or bytes) and return its path."""

    def make(name: str, content: str | bytes) -> Path:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return make


@pytest.fixture
def make_ply(make_file: MakeFile) -> MakeFile:
    """Write a PLY file from its encoding, the lines of its elements and its body."""

    def make(encoding: str, elements: str, body: str | bytes, newline: str = "\n") -> Path:
        header = f"ply\nformat {encoding} 1.0\n{elements}end_header\n".replace("\n", newline)
        return make_file(
            "made.ply", header.encode() + (body.encode() if isinstance(body, str) else body)
        )

    return make


@pytest.fixture
def cloud() -> PointCloud:
    """Points that float32 holds exactly, with normals and colours."""
    random = np.random.default_rng(1)
    positions = random.normal(size=(50, 3)).astype(np.float32).astype(np.float64)
    normals = random.normal(size=(50, 3)).astype(np.float32).astype(np.float64)
    return PointCloud(positions, normals, random.integers(0, 256, (50, 3)).astype(np.uint8))


@pytest.fixture
def tetrahedron() -> Mesh:
    """The simplest closed mesh, with corners that float32 holds exactly."""
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.5]])
    return Mesh(vertices, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))


@pytest.fixture
def painted(tetrahedron: Mesh) -> Mesh:
    """The simplest mesh with something of all that vertices can carry."""
    normals = tetrahedron.vertices + np.array([0.25, 0.5, 0.125])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(
        tetrahedron,
        origin=np.array([4.0e5, 5.4e6, 0.0]),
        normals=normals,
        colours=np.array([[0, 1, 2], [255, 254, 253], [127, 128, 129], [50, 100, 200]], np.uint8),
        attributes={
            "intensity": np.array([1, 65535, 300, 4], np.uint16),
            "gps time": np.array([3.5e8, 3.5e8 + 1e-6, np.nan, -1.0]),
            "is <good>": np.array([True, False, True, True]),
            "number": np.array([1, -2, 3, 2**40]),
            "half": np.array([0.5, 1.0, -2.0, 8.0], np.float16),
        },
    )
