"""Tables of measured figures, each with its machine, commit, command and date.

::

    measure.py ── starts ── a script with `-o results/NAME.json` ── write_table ──> NAME.json
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

Row = list[str | float]
ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
BUILD = ("hpcapp", "hpccomponent", "loader", "deploy", "CMakeLists.txt", "pyproject.toml")
"""What is measured: a commit of something else makes no figure older."""


def ask_git(*words: str) -> str | None:
    """Return what git says of this clone; None where it fails, or there is no history."""
    command = ["git", "-C", str(ROOT), *words]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def find_build() -> str | None:
    """Return the last commit that changed what is measured; None without history."""
    return ask_git("log", "-1", "--format=%h", "--", *BUILD) or None


def count_age(commit: str) -> int | None:
    """Return by how many commits this build is younger than one of its own history, or None."""
    if ask_git("merge-base", "--is-ancestor", commit, "HEAD") is None:
        return None
    return int(ask_git("rev-list", "--count", f"{commit}..HEAD") or 0)


def parser_of(text: str | None) -> argparse.ArgumentParser:
    """Return a parser of a script whose table goes to the file that ``-o`` names."""
    parser = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write the table as JSON")
    return parser


def write_table(
    path: Path | None,
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str | float]],
    notes: Sequence[str] = (),
) -> None:
    """Write a table as JSON, whole or not at all; nothing where no path is given."""
    if path is None:
        return
    table = {
        "title": title,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, "
        f"load average {os.getloadavg()[0]:.1f} at the end",
        "commit": find_build() or "unknown",
        "date": datetime.now(UTC).date().isoformat(),
        "command": _describe_command(),
        "columns": columns,
        "rows": rows,
        "notes": notes,
    }
    part = path.with_suffix(".part")
    part.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    part.replace(path)


def _describe_command() -> str:
    """Return the command line of this script, less where its table goes."""
    words = sys.argv[1:]
    for option in ("-o", "--output"):
        if option in words:
            at = words.index(option)
            del words[at : at + 2]
    return shlex.join(["python", f"benchmarks/{Path(sys.argv[0]).name}", *words])
