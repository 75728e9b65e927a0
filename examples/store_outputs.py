"""Run the notebook and store what its cells show: python examples/store_outputs.py.

Of a mesh the picture is stored, and not the page that turns it, which weighs half a megabyte.
"""

from __future__ import annotations

import base64
import json
import os
import tempfile
from pathlib import Path
from typing import Any

from IPython.core.interactiveshell import InteractiveShell
from IPython.utils.capture import capture_output

from hpccomponent.foreign_json import decode

NOTEBOOK = Path(__file__).with_name("first-mesh.ipynb")
STORED = ("image/png", "text/plain")


def run_cell(shell: InteractiveShell, source: str, count: int) -> list[dict[str, Any]]:
    """Run a cell; return its outputs as notebooks have them."""
    with capture_output():
        done = shell.run_cell(source, store_history=True)
    done.raise_error()
    outputs: list[dict[str, Any]] = []
    if done.result is not None:
        bundle, _ = shell.display_formatter.format(done.result, include=STORED)
        if "image/png" in bundle:
            bundle["image/png"] = base64.b64encode(bundle["image/png"]).decode()
        outputs.append({"output_type": "execute_result", "execution_count": count,
                        "metadata": {}, "data": bundle})  # fmt: skip
    return outputs


def main() -> None:
    """Run all cells in a temporary folder, and write the notebook."""
    notebook = decode(NOTEBOOK.read_bytes(), dict[str, Any])
    shell = InteractiveShell.instance()
    home = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
        for count, cell in enumerate(cells, 1):
            cell["outputs"] = run_cell(shell, "".join(cell["source"]), count)
            cell["execution_count"] = count
        os.chdir(home)
    NOTEBOOK.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
