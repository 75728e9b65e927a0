"""Small clouds in files, and the command as a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from multiprocessing import resource_tracker
from pathlib import Path

import numpy as np
import pytest
import zmq

from hpcapp.io import write_points
from hpccomponent.surface.points import FloatArray, PointCloud

WriteCloud = Callable[..., Path]
StartCommand = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture(scope="session")
def standing_helpers() -> None:
    """Start what lives as long as the interpreter, before leaks are counted.

    These are the tracker of multiprocessing, and the thread that pyzmq keeps from its first
    zero-copy send on.
    """
    resource_tracker.ensure_running()
    with zmq.Context() as context, context.socket(zmq.PAIR) as one, context.socket(zmq.PAIR) as two:
        one.bind("inproc://warm-up")
        two.connect("inproc://warm-up")
        one.send(bytes(1 << 20), copy=False)
        two.recv()


@pytest.fixture
def sphere() -> PointCloud:
    """Points of the unit sphere, normals outwards."""
    normals = np.random.default_rng(7).normal(size=(1500, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return PointCloud(normals.copy(), normals)


@pytest.fixture
def write_cloud(tmp_path: Path) -> WriteCloud:
    """Write positions and normals to a file and return its path."""

    def write(positions: FloatArray, normals: FloatArray | None, name: str = "in.ply") -> Path:
        path = tmp_path / name
        write_points(path, PointCloud(positions, normals))
        return path

    return write


@pytest.fixture
def sphere_file(sphere: PointCloud, write_cloud: WriteCloud) -> Path:
    return write_cloud(sphere.positions, sphere.normals, "sphere.ply")


@pytest.fixture
def start_command(tmp_path: Path) -> StartCommand:
    """Start ``hpcapp`` in a process group of its own, in the test's folder."""

    def start(*arguments: str, **settings: object) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-m", "hpcapp", *arguments],
            cwd=tmp_path,
            env={**os.environ, "TMPDIR": str(tmp_path)},
            text=True,
            start_new_session=True,
            **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **settings},  # type: ignore[call-overload]
        )

    return start
