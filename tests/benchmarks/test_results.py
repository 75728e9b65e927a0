"""Every table of measured figures says where it comes from, and is one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

RESULTS = sorted((Path(__file__).parents[2] / "benchmarks" / "results").glob("*.json"))


@pytest.mark.slow
@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.stem)
def test_a_result_names_its_origin_and_fills_its_columns(path: Path) -> None:
    result = json.loads(path.read_text(encoding="utf-8"))
    assert set(result) == {"title", "machine", "commit", "command", "columns", "rows", "notes"}
    assert all(result[key] for key in ("title", "machine", "commit", "command", "rows"))
    assert {len(row) for row in result["rows"]} == {len(result["columns"])}
