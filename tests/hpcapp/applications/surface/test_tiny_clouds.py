"""Whatever few points are: a mesh, or one line that says why there is none."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import hpcapp
from hpcapp.backends.selection import open_executor
from hpcapp.geometry.points import FloatArray
from hpccomponent.errors import InputError, JobError

Random = np.random.Generator


def on_a_line(random: Random, count: int) -> FloatArray:
    return np.outer(random.normal(size=count), random.normal(size=3))


def in_a_plane(random: Random, count: int) -> FloatArray:
    return random.normal(size=(count, 2)) @ random.normal(size=(2, 3))


def with_one_coordinate(random: Random, count: int) -> FloatArray:
    points = random.normal(size=(count, 3))
    points[:, random.integers(3)] = random.normal()
    return points


def in_two_clusters(random: Random, count: int) -> FloatArray:
    places = random.normal(size=(2, 3))[random.integers(0, 2, count)]
    points: FloatArray = places + 1e-3 * random.normal(size=(count, 3))
    return points


def repeated(random: Random, count: int) -> FloatArray:
    few: FloatArray = random.normal(size=(max(count // 2, 1), 3))
    return few[random.integers(0, len(few), count)]


def nearly_on_a_line(random: Random, count: int) -> FloatArray:
    steps = np.arange(count, dtype=np.float64)
    bent = np.stack([0.49 * steps, 0.22 * steps, -0.003 * steps**1.6], axis=1)
    return np.round(np.array([289814.15, 4320978.61, 170.76]) + bent, 2)


KINDS: dict[str, Callable[[Random, int], FloatArray]] = {
    "anywhere": lambda random, count: random.normal(size=(count, 3)),
    "on a line": on_a_line,
    "in a plane": in_a_plane,
    "with one coordinate": with_one_coordinate,
    "in two clusters": in_two_clusters,
    "in one cell": lambda random, count: 1e-9 * random.normal(size=(count, 3)),
    "on a grid": lambda random, count: random.integers(-2, 3, (count, 3)).astype(np.float64),
    "repeated": repeated,
    "nearly on a line": nearly_on_a_line,
    "tiny": lambda random, count: 1e-34 * random.normal(size=(count, 3)),
    "huge": lambda random, count: 1e34 * random.normal(size=(count, 3)),
    "too tiny": lambda random, count: 1e-50 * random.normal(size=(count, 3)),
    "too huge": lambda random, count: 1e45 * random.normal(size=(count, 3)),
}
NORMALS: dict[str, Callable[[Random, FloatArray], FloatArray | None]] = {
    "none": lambda random, points: None,
    "any": lambda random, points: random.normal(size=points.shape),
    "alike": lambda random, points: np.tile([0.0, 0.0, 1.0], (len(points), 1)),
}


def reconstruct(
    kind: str, count: int, normals: str, method: str, seed: int, executor: str | Executor
) -> None:
    """Reconstruct a tiny cloud; numpy's warnings are errors here."""
    random = np.random.default_rng(seed)
    points = KINDS[kind](random, count)
    try:
        mesh = hpcapp.reconstruct(
            points, NORMALS[normals](random, points), 16, method=method, executor=executor
        )
    except InputError:
        return
    except JobError as error:
        assert "one sign on the whole grid" in str(error)  # noqa: PT017 - one that says why
        return
    assert len(mesh.faces)
    assert np.isfinite(mesh.vertices).all()


@settings(max_examples=120)
@given(
    st.sampled_from(list(KINDS)),
    st.integers(1, 50) | st.integers(10, 20),
    st.sampled_from(list(NORMALS)),
    st.sampled_from(["hierarchical", "paper"]),
    st.integers(0, 1 << 30),
)
@example("nearly on a line", 10, "none", "hierarchical", 0)
@example("on a grid", 12, "none", "hierarchical", 0)
@example("too tiny", 20, "none", "hierarchical", 0)
def test_here(kind: str, count: int, normals: str, method: str, seed: int) -> None:
    reconstruct(kind, count, normals, method, seed, "serial")


@pytest.mark.slow
def test_on_workers() -> None:
    with open_executor("zmq", workers=2) as backend:
        for seed, kind in enumerate(KINDS):
            for normals in NORMALS:
                for method in ("hierarchical", "paper"):
                    reconstruct(kind, 10 + seed, normals, method, seed, backend.executor)
