"""The notebook runs from its first cell to its last, and is kept without outputs."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[2] / "examples" / "first-mesh.ipynb"


def read_cells() -> list[tuple[str, bool]]:
    """Return the source of each cell of code, and whether it has outputs."""
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    return [
        ("".join(cell["source"]), bool(cell["outputs"] or cell["execution_count"]))
        for cell in cells
        if cell["cell_type"] == "code"
    ]


def test_the_notebook_has_no_outputs() -> None:
    assert not any(has_outputs for _, has_outputs in read_cells())


@pytest.mark.slow
def test_every_cell_runs_and_the_mesh_is_shown(tmp_path: Path) -> None:
    cells = [source for source, _ in read_cells()]
    assert "mesh" in cells  # the cell that shows it
    checks = ["assert 'iframe' in mesh._repr_html_()", "assert measures.l1 < 0.1"]
    script = "\n".join([*cells, *checks])
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True, timeout=120)
    assert (tmp_path / "knot.glb").read_bytes().startswith(b"glTF")
