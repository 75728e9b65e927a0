"""Tables of measured figures, each with its machine, commit and command."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from pathlib import Path

Row = list[str | float]
SHARED = "virtual machine, 2 cores, shared with other work"


def write_table(
    path: Path,
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str | float]],
    command: str,
    notes: Sequence[str] = (),
    machine: str = SHARED,
) -> None:
    """Write a table as JSON; its folder is made."""
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"],
        cwd=Path(__file__).parent, capture_output=True, text=True, check=False,
    )  # fmt: skip
    table = {
        "title": title,
        "machine": machine,
        "commit": commit.stdout.strip() or "unknown",
        "command": command,
        "columns": columns,
        "rows": rows,
        "notes": notes,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
