"""The notebook runs from its first cell to its last, and is kept with what its cells show."""

from __future__ import annotations

import ast
import asyncio
import json
import re
from pathlib import Path
from typing import Any

import pytest

import hpcapp

NOTEBOOK = Path(__file__).parents[2] / "examples" / "first-mesh.ipynb"
MOST_BYTES = 700_000


def read_cells() -> list[dict[str, Any]]:
    """Return the cells of code."""
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


def test_it_is_stored_with_its_pictures() -> None:
    cells = read_cells()
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    kinds = [kind for cell in cells for output in cell["outputs"] for kind in output["data"]]
    assert kinds.count("image/png") == 2
    assert "text/html" not in kinds
    assert NOTEBOOK.stat().st_size < MOST_BYTES


def test_it_uses_only_public_names() -> None:
    source = "\n".join("".join(cell["source"]) for cell in read_cells())
    names = set(re.findall(r"\bhpcapp\.(\w+)", source)) - {"reconstruct"}
    assert names <= set(hpcapp.__all__)
    assert re.findall(r"^\s*(?:from|import) .*", source, re.MULTILINE) == ["import hpcapp"]


@pytest.mark.slow
def test_every_cell_runs_and_shows_what_is_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}

    async def run() -> None:
        for cell in read_cells():
            tree = ast.parse("".join(cell["source"]))
            last = tree.body[-1]
            if isinstance(last, ast.Expr):
                tree.body[-1] = ast.copy_location(
                    ast.Assign([ast.Name("shown", ast.Store())], last.value), last
                )
            code = compile(ast.fix_missing_locations(tree), "cell", "exec",
                           ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)  # fmt: skip
            running = eval(code, names)  # noqa: S307 - our own notebook
            if running is not None:
                await running
            for output in cell["outputs"]:
                stored = "".join(output["data"]["text/plain"])
                assert re.sub(r"\s", "", repr(names["shown"])) == re.sub(r"\s", "", stored)

    asyncio.run(run())
    assert "iframe" in names["mesh"]._repr_html_()
    assert names["measures"].mean < 0.001 * names["measures"].diagonal
    assert (tmp_path / "knot.glb").read_bytes().startswith(b"glTF")
    assert "Decided" in (tmp_path / "knot.html").read_text()
