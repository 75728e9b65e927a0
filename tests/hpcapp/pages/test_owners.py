"""Tiles and workers in reports."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpcapp.geometry.mesh import Mesh
from hpcapp.pages.owners import TILE, Owners, mark_tiles, take_labels
from hpccomponent.errors import InputError

PLY = Path("m.ply")
FIVE = Mesh(np.zeros((5, 3)), np.array([[0, 1, 2]]), np.zeros(3))
GOOD: dict[str, object] = {"tiles": [0, 2], "vertices": [2, 3], "workers": ["a", "b", "a"]}


@given(st.lists(st.integers(0, 40), min_size=1, max_size=200), st.booleans())
def test_a_report_tells_each_vertex(tiles: list[int], knows_workers: bool) -> None:
    workers = [f"w-{tile % 7}" for tile in range(41)] if knows_workers else []
    told = json.loads(json.dumps({"owners": Owners(np.array(tiles, np.int32), workers).to_json()}))
    mesh = Mesh(np.zeros((len(tiles), 3)), np.empty((0, 3), np.int64), np.zeros(3))
    marked, known = mark_tiles(mesh, PLY, told, "r.json")
    assert marked.attributes[TILE].tolist() == tiles
    assert known == workers
    bare, labels = take_labels(marked, known)
    assert not bare.attributes
    assert [label.name for label in labels] == ["tile", "worker"][: 1 + knows_workers]
    if knows_workers:
        names = labels[1].labels or ()
        assert [names[number] for number in labels[1].values] == [workers[tile] for tile in tiles]


@pytest.mark.parametrize(
    ("path", "told"),
    [
        (PLY, {}),
        (Path("m.stl"), {"owners": GOOD}),
        (PLY, {"owners": GOOD | {"vertices": [2, 4]}}),
        (PLY, {"owners": GOOD | {"vertices": [2, 10**18]}}),
        (PLY, {"owners": GOOD | {"tiles": [0, 10**9], "workers": []}}),
    ],
)
def test_another_mesh_has_no_tiles(path: Path, told: dict[str, object]) -> None:
    marked, workers = mark_tiles(FIVE, path, told, "r.json")
    assert take_labels(marked, workers) == (FIVE, [])


@pytest.mark.parametrize(
    "told",
    [
        None,
        [],
        "x",
        {"tiles": [0]},
        GOOD | {"tiles": [0, 3]},
        GOOD | {"tiles": [-1, 2]},
        GOOD | {"tiles": ["a", "b"]},
        GOOD | {"tiles": [0, 10**12]},
        GOOD | {"vertices": [5]},
        GOOD | {"vertices": [-2, 7]},
        GOOD | {"vertices": None},
    ],
)
def test_what_tells_no_tiles_is_refused(told: object) -> None:
    with pytest.raises(InputError, match=r"r\.json: 'owners'"):
        mark_tiles(FIVE, PLY, {"owners": told}, "r.json")
