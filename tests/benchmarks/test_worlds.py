"""Random worlds of one seed come out as `benchmarks/worlds.py` has recorded, or better."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest
from shared_data import shared
from worlds import FAMILIES, SEED, Verdict, judge_family, judge_world, make_worlds, reconstruct

from hpcapp.geometry.mesh import Mesh

RECORD = Path(__file__).parents[2] / "benchmarks/results/worlds-ci.json"


@pytest.fixture(scope="module")
def data() -> Path:
    pytest.importorskip("embreex", reason="there are no wheels of embreex for this machine")
    folders = [shared(name) for name in ("worlds", "raw", "tuning")]
    return folders[0].parent


QUICK = {"streets", "works", "sheets", "plants", "volumes", "solids"}  # a fifth of the time of all


@pytest.mark.slow
@pytest.mark.parametrize(
    "family",
    [pytest.param(name, marks=[] if name in QUICK else [pytest.mark.long]) for name in FAMILIES],
)
def test_as_many_are_right_as_were_and_no_more_are_wrong_in_silence(
    family: str, data: Path
) -> None:
    table = json.loads(RECORD.read_text(encoding="utf-8"))
    rows = {row[0]: dict(zip(table["columns"], row, strict=True)) for row in table["rows"]}
    verdicts = list(judge_family(data, family))
    counts = Counter(verdict.kind for verdict in verdicts)
    assert counts["right"] >= rows[family]["right"], verdicts
    assert counts["silent"] <= rows[family]["silent"], verdicts


def turn_inside_out(path: Path) -> Mesh:
    mesh = reconstruct(path)
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


@pytest.mark.slow
def test_a_mesh_that_is_inside_out_is_wrong_in_silence(data: Path, tmp_path: Path) -> None:
    ((name, entry),) = make_worlds(data, tmp_path, "whole_object", SEED, 1).items()
    assert judge_world(data, tmp_path, name, entry) == Verdict(name, "right", [])
    turned = judge_world(data, tmp_path, name, entry, turn_inside_out)
    assert turned == Verdict(name, "silent", ["side"])
